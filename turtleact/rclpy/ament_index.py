"""The functions of ``ament_index_python`` that find packages."""

from __future__ import annotations

import os
from pathlib import Path

from turtleact.interfaces.finders import folders_near, package_name

__all__ = [
    "PackageNotFoundError",
    "get_package_prefix",
    "get_package_share_directory",
    "get_package_share_path",
]


class PackageNotFoundError(KeyError):
    """No package of that name was found."""


def get_package_prefix(package_name: str) -> str:
    """Return the prefix of a package, or its source folder if the package is not installed.

    Raises:
        PackageNotFoundError: if there is no such package.
    """
    for prefix in filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)):
        if Path(prefix, "share", package_name).is_dir():
            return prefix
    return str(_sources(package_name))


def get_package_share_directory(package_name: str, print_warning: bool = True) -> str:  # noqa: ARG001  # ament's signature
    """Return the share folder of a package, or its source folder if the package is not installed.

    Raises:
        PackageNotFoundError: if there is no such package.
    """
    prefix = get_package_prefix(package_name)
    share = Path(prefix, "share", package_name)
    return str(share) if share.is_dir() else prefix


def get_package_share_path(package_name: str, print_warning: bool = True) -> Path:
    """Return the folder of `get_package_share_directory` as a `Path`."""
    return Path(get_package_share_directory(package_name, print_warning))


def _sources(name: str) -> Path:
    for folder in folders_near(Path()):
        if package_name(folder) == name:
            return folder.absolute()
    raise PackageNotFoundError(
        f"package '{name}' not found: in no sourced workspace, and not in the working directory"
    )
