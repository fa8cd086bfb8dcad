"""Packages and interface files near a folder, found by a bounded search."""

from __future__ import annotations

import pytest

from turtleact.interfaces import finders
from turtleact.interfaces.finders import (
    find_interfaces,
    folders_near,
    interface_files,
    package_name,
)


def write(folder, name="Go", kind="action"):
    """Write an empty interface into the package in a folder, and return its path."""
    path = folder / kind / f"{name}.{kind}"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()
    return path


@pytest.mark.parametrize("kind", ["msg", "srv", "action"])
@pytest.mark.parametrize("place", ["lab", "src/lab", "src/repository/lab"])
def test_an_interface_is_found(tmp_path, place, kind):
    path = write(tmp_path / place, "Go", kind)
    assert find_interfaces(tmp_path) == {f"lab/{kind}/Go": path}


def test_an_interface_is_found_in_the_folder_itself(tmp_path):
    path = write(tmp_path / "lab")
    assert find_interfaces(tmp_path / "lab") == {"lab/action/Go": path}


@pytest.mark.parametrize("place", ["a/b/lab", "src/a/b/lab", ".hidden/lab", "src/.hidden/lab"])
def test_a_package_is_not_looked_for_elsewhere(tmp_path, place):
    write(tmp_path / place)
    assert find_interfaces(tmp_path) == {}


@pytest.mark.parametrize("here", ["src", "src/arm", "src/arm/arm/deeper"])
def test_the_other_packages_of_the_same_src_are_found(tmp_path, here):
    path = write(tmp_path / "src" / "lab")
    nested = write(tmp_path / "src" / "repository" / "leg")
    (tmp_path / here).mkdir(parents=True, exist_ok=True)
    assert find_interfaces(tmp_path / here) == {"lab/action/Go": path, "leg/action/Go": nested}


@pytest.mark.parametrize("name", ["go", "2Go", "Go-1", "Go Home"])
def test_files_that_are_no_interfaces_are_left_out(tmp_path, name):
    write(tmp_path / "lab", name)
    (tmp_path / "lab" / "action" / "Readme.md").touch()
    assert find_interfaces(tmp_path) == {}


def test_the_name_of_a_package_is_in_its_package_xml(tmp_path):
    path = write(tmp_path / "my-repository")
    assert interface_files(tmp_path / "my-repository") == {}
    (tmp_path / "my-repository" / "package.xml").write_text("<package>\n<name> arm </name>")
    assert interface_files(tmp_path / "my-repository") == {"arm/action/Go": path}


@pytest.mark.parametrize(
    ("text", "name"),
    [("", "lab"), ("<name></name>", "lab"), ("\0", "lab"), ("<name>../x</name>", "")],
)
def test_without_a_name_in_its_package_xml_a_package_is_called_as_its_folder(tmp_path, text, name):
    (tmp_path / "lab").mkdir()
    (tmp_path / "lab" / "package.xml").write_text(text)
    assert package_name(tmp_path / "lab") == name


def test_only_so_many_folders_are_looked_at(tmp_path, monkeypatch):
    for number in range(9):
        (tmp_path / f"lab{number}").mkdir()
    monkeypatch.setattr(finders, "MOST_FOLDERS", 5)
    assert [each.name for each in folders_near(tmp_path)][1:] == [f"lab{n}" for n in range(5)]


def test_a_folder_that_is_gone_has_nothing(tmp_path):
    assert find_interfaces(tmp_path / "gone") == {}
