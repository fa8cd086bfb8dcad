"""What a shell is told so that it completes our command lines, and where it is told so.

Each script calls the program with the words of the line up to the cursor, the last of them maybe
begun, in an environment where ``_TURTLEACT_COMPLETE`` names the shell; what it prints is what may
stand there, a line each, in zsh and fish with a tab and a few words on it. Where nothing is
printed, the shell completes files.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

from turtleact.errors import TurtleactError, UsageError

__all__ = ["SCRIPTS", "install", "script"]

_BASH: Final = """\
_turtleact_completion() {
    local line program=turtleact
    [[ $1 == */turtleact ]] && program=$1
    COMPREPLY=()
    while IFS= read -r line; do
        COMPREPLY+=("$line")
    done < <(_TURTLEACT_COMPLETE=bash "$program" "${COMP_WORDS[@]:0:COMP_CWORD+1}" 2>/dev/null)
}
complete -o default -F _turtleact_completion turtleact
"""

_ZSH: Final = """\
#compdef turtleact
_turtleact() {
    local line
    local -a values shown
    while IFS= read -r line; do
        values+=("${line%%$'\\t'*}")
        shown+=("${line/$'\\t'/  -- }")
    done < <(_TURTLEACT_COMPLETE=zsh turtleact "${(@)words[1,CURRENT]}" 2>/dev/null)
    if (( $#values )); then
        compadd -l -d shown -a -- values
    else
        _files
    fi
}
if [[ $funcstack[1] == _turtleact ]]; then
    _turtleact "$@"
else
    compdef _turtleact turtleact
fi
"""

_FISH: Final = """\
function __turtleact_complete
    set -l words (commandline -opc) (commandline -ct)
    set -l found (_TURTLEACT_COMPLETE=fish command turtleact $words 2>/dev/null)
    if set -q found[1]
        printf '%s\\n' $found
    else
        __fish_complete_path (commandline -ct)
    end
end
complete -c turtleact -f -a '(__turtleact_complete)'
"""

SCRIPTS: Final = {"bash": _BASH, "zsh": _ZSH, "fish": _FISH}


def script(shell: str | None) -> str:
    """What a shell is told; that of the user if None.

    Raises:
        UsageError: if it is none that we know.
    """
    return SCRIPTS[_known(shell)]


def install(shell: str | None) -> str:
    """Write that to where the shell reads it when it starts.

    Returns:
        What was done, and what is left to do.

    Raises:
        UsageError: if it is no shell that we know.
        TurtleactError: if it cannot be written; the text says where.
    """
    name = _known(shell)
    try:
        return f"{name} completes turtleact as {_write(name)} says, from the next terminal on"
    except OSError as error:
        problem = f"{error.filename} cannot be written: {error.strerror}"
        raise TurtleactError(
            f"{problem}; --show-completion prints what is to stand there"
        ) from None


def _write(name: str) -> Path:
    """Write the script of a shell, and see to it that it is read; gives its place."""
    home = Path.home()
    places = {
        "bash": home / ".bash_completions" / "turtleact.sh",
        "zsh": home / ".zfunc" / "_turtleact",
        "fish": home / ".config" / "fish" / "completions" / "turtleact.fish",
    }
    place = places[name]
    place.parent.mkdir(parents=True, exist_ok=True)
    place.write_text(SCRIPTS[name], "utf-8")
    if name == "bash":
        _add_line(home / ".bashrc", f"source '{place}'")
    if name == "zsh":
        _add_line(home / ".zshrc", "fpath+=~/.zfunc; autoload -Uz compinit; compinit")
    return place


def _known(shell: str | None) -> str:
    name = Path(shell or os.environ.get("SHELL", "")).name
    if name not in SCRIPTS:
        known = " or ".join(SCRIPTS)
        raise UsageError(f"completion is for {known}, not '{name}': give one of them")
    return name


def _add_line(file: Path, line: str) -> None:
    """Add a line to a file that has it not."""
    text = file.read_text("utf-8") if file.exists() else ""
    if line not in text.splitlines():
        gap = "" if not text or text.endswith("\n") else "\n"
        with file.open("a", encoding="utf-8") as opened:
            opened.write(f"{gap}{line}\n")
