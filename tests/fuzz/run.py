"""Fuzzes one reader, guided by coverage: ``python -m tests.fuzz.run NAME FOLDER [SECONDS]``.

NAME is one of ``properties.PROPERTIES``. Wants Atheris (``pip install atheris``), which is no
dependency. What makes new ground is kept in the folder, where the next run begins; an input that
fails is written beside it. One that takes a second of the processor, or asks for a gigabyte, fails.
"""

from __future__ import annotations

import resource
import sys
import time
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["turtleact", "yaml", "json"]):
    from tests.fuzz import properties as fuzz
    from tests.fuzz.seeds import seeds
    from turtleact.interfaces import cdr, classes, conversion, values

SLOW = 1.0
MEMORY = 2**30


def main() -> None:
    name, folder = sys.argv[1], Path(sys.argv[2])
    seconds = sys.argv[3] if len(sys.argv) > 3 else "0"
    folder.mkdir(parents=True, exist_ok=True)
    for number, seed in enumerate(seeds(name)):
        (folder / f"seed{number:04}").write_bytes(seed)
    limit = used() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    makes_classes = name in ("interface", "anytype")
    count = 0

    def one(data: bytes) -> None:
        nonlocal count
        began = time.process_time()
        fuzz.PROPERTIES[name](data)
        taken = time.process_time() - began
        if taken > SLOW:
            raise AssertionError(f"{taken:.1f} s for {len(data)} bytes")
        count += 1
        if makes_classes and count % 1000 == 0:
            forget_classes()

    arguments = [sys.argv[0], str(folder), f"-max_total_time={seconds}", "-timeout=20"]
    arguments += [f"-artifact_prefix={folder}.", "-max_len=4096", "-print_final_stats=1"]
    arguments += ["-rss_limit_mb=2048", "-verbosity=1", "-report_slow_units=2"]
    atheris.Setup(arguments, one)
    atheris.Fuzz()


def used() -> int:
    """The address space of this process in bytes."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    return pages * resource.getpagesize()


def forget_classes() -> None:
    """Drops what is kept of each class, as those of the fuzzer are many."""
    for module in (cdr, classes, conversion, values):
        for each in vars(module).values():
            if callable(clear := getattr(each, "cache_clear", None)):
                clear()


if __name__ == "__main__":
    main()
