"""The hashes of interface types, for `TopicEndpointInfo`."""

from __future__ import annotations

__all__ = ["TypeHash"]

SIZE = 32


class TypeHash:
    """The hash of an interface type.

    Args:
        version: The version of the algorithm; -1 if there is no hash.
        value: The 32 bytes of the hash.
    """

    __slots__ = ("_value", "_version")

    def __init__(self, version: int = -1, value: bytes = bytes(SIZE)) -> None:
        self.version = version
        self.value = value

    @classmethod
    def from_text(cls, text: str) -> TypeHash:
        """Parse a hash such as ``RIHS01_…``. For any other text, return a hash with version -1."""
        version, _, digits = text.removeprefix("RIHS").partition("_")
        try:
            return cls(int(version), bytes.fromhex(digits))
        except ValueError:
            return cls()

    @property
    def version(self) -> int:
        """The version of the algorithm; -1 if there is no hash."""
        return self._version

    @version.setter
    def version(self, value: int) -> None:
        assert isinstance(value, int)  # noqa: S101  # as in rclpy
        self._version = value

    @property
    def value(self) -> bytes:
        """The 32 bytes of the hash."""
        return self._value

    @value.setter
    def value(self, value: bytes) -> None:
        assert isinstance(value, bytes)  # noqa: S101  # as in rclpy
        self._value = value

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, TypeHash):
            return False
        return (self._version, self._value) == (other._version, other._value)

    def __hash__(self) -> int:
        return hash((self._version, self._value))

    def __str__(self) -> str:
        if self._version <= 0 or len(self._value) != SIZE:
            return "INVALID"
        return f"RIHS{self._version:02}_{self._value.hex()}"
