"""Types that several modules of rclpy use in their annotations."""

from __future__ import annotations

from typing import Any, TypeAlias

__all__ = ["Anything", "Subscriptable"]

Anything: TypeAlias = Any
"""The type of the program's messages, interfaces and callbacks.

The type is `Any`, because message classes are made at run time, so no type checker knows their
fields. Also, rclpy calls a callback with as many arguments as the callback takes.
"""


class Subscriptable:
    """A class that annotations may subscript with any arguments, as in ``Publisher[String]``.

    The number of type parameters of rclpy's classes differs between the distributions of ROS 2.
    """

    def __class_getitem__(cls, parameters: object) -> type:
        """Return the class itself."""
        return cls
