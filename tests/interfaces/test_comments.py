"""Comments on fields, from files and from docstrings."""

from __future__ import annotations

from typing import ClassVar

import pytest

from turtleact.interfaces import (
    Action,
    Message,
    Service,
    float64,
    get_action,
    get_interface,
    interface_source,
    interface_text,
    load_interfaces,
    string,
    type_hash,
)
from turtleact.interfaces.loading import commented_text, comments
from turtleact.interfaces.parse import parse
from turtleact.interfaces.types import definition

from ..registry import isolated_registry


@pytest.fixture(autouse=True)
def own_registry():
    with isolated_registry():
        yield


class Hoist(Action, type_name="comment_tests/action/Hoist"):
    """Hoist a load."""

    class Goal(Message):
        """What to hoist.

        Attributes:
            load: Its name, as ``one`` or ``two``. This comment is so long that a line of eighty
                characters cannot hold all of it.
            height: How high (m).
        """

        LOAD_ONE: ClassVar[string] = "one"
        load: string = "one"
        height: float64 = 1.5

    class Result(Message):
        pass

    class Feedback(Message):
        height: float64 = 0.0


class Lamp(Service, type_name="comment_tests/srv/Lamp"):
    class Request(Message):
        """Switch it."""


HOIST = """\
# Hoist a load.

# What to hoist.

string LOAD_ONE="one"
# Its name, as `one` or `two`. This comment is so long that a line of eighty
# characters cannot hold all of it.
string load "one"
# How high (m).
float64 height 1.5
---
---
float64 height"""


def test_the_text_of_a_class_has_the_comments_of_its_docstrings():
    assert commented_text(Hoist) == HOIST


def test_a_class_without_docstrings_has_no_comments():
    assert commented_text(Lamp) == "# Switch it.\n\n---"
    assert commented_text(Hoist.Feedback) == "float64 height"


def test_comments_change_neither_definition_nor_hash():
    hashed = type_hash(Hoist)
    assert parse(commented_text(Hoist), Hoist.type_name) == definition(Hoist)
    assert interface_source(Hoist.type_name) == interface_text(Hoist)
    assert type_hash(Hoist) == hashed


def test_the_comments_can_be_read_back_from_the_text(tmp_path):
    folder = tmp_path / "comment_tests" / "action"
    folder.mkdir(parents=True)
    (folder / "Lift.action").write_text(commented_text(Hoist))
    load_interfaces(tmp_path)
    assert comments(get_action("comment_tests/action/Lift").Goal)["height"] == "How high (m)."


def test_a_file_is_left_as_its_author_wrote_it(tmp_path):
    folder = tmp_path / "comment_tests" / "action"
    folder.mkdir(parents=True)
    text = HOIST.replace("# How high (m).\n", "")
    (folder / "Hoist.action").write_text(text)
    load_interfaces(tmp_path)
    assert commented_text(get_interface(Hoist.type_name)) == text
