"""Makes ``import rclpy`` and ``from std_msgs.msg import String`` find turtleact's modules.

`install` puts a finder in front of Python's own finders, for this process only. No file is ever
installed under the name ``rclpy``. The finder provides

- ``rclpy`` and its modules, which are the modules of `turtleact.rclpy` under a second name;
- ``PKG.msg``, ``PKG.srv`` and ``PKG.action`` of every package with known interfaces;
- small parts of ``ament_index_python`` and ``rosidl_runtime_py``.

``from nav2_msgs.action import NavigateToPose`` also finds a type that no installed package has: the
type is learned. The user's cache is looked at first. If it has no version of the type, or several,
the graph is asked once, in a session of its own, because the program has not called ``rclpy.init``
yet. A thread runs that session, because the importing one may have an event loop. Python holds its
import lock while it looks for a module, so no thread could import anything then. Types must
therefore be learned while a module is executed or asked for a name, never by `find_spec`.

If a program imports a part of ROS that turtleact does not have, an `ImportError` says so.

Source: Python's ``importlib`` documentation, "Importing a source file directly" and "Finders".
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from functools import cache
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import find_spec
from types import ModuleType
from typing import TYPE_CHECKING, Final

from turtleact.errors import NotLearned, TurtleactError, UnknownInterface
from turtleact.interfaces import get_interface, known_interfaces, type_hash
from turtleact.interfaces.definition import type_name_pattern
from turtleact.interfaces.learned import cached, cached_names, remember
from turtleact.interfaces.loading import find_interface, learned_classes
from turtleact.rclpy.face import SETTINGS

if TYPE_CHECKING:
    from turtleact.node.learning import Learner
    from turtleact.transports.graph import Kind

__all__ = ["Finder", "install", "uninstall"]

OURS: Final = "turtleact.rclpy"
KINDS: Final = ("msg", "srv", "action")

SUFFIXES: Final = ("_msgs", "_interfaces", "_srvs", "_actions", "_msg", "_action", "_interface")
"""The suffixes that names of interface packages usually have."""

ALIASES: Final = {
    **dict.fromkeys(
        (
            "expand_topic_name",
            "topic_or_service_is_hidden",
            "validate_full_topic_name",
            "validate_namespace",
            "validate_node_name",
            "validate_parameter_name",
            "validate_topic_name",
        ),
        "names",
    ),
    **dict.fromkeys(("callback_groups", "guard_condition", "handle", "waitable"), "impl.entity"),
    **dict.fromkeys(("client", "service", "service_introspection"), "services"),
    **dict.fromkeys(("publisher", "subscription", "qos_overriding_options"), "topics"),
    **dict.fromkeys(("type_description_service", "wait_for_message"), "node"),
    **dict.fromkeys(("impl.logging_severity", "impl.rcutils_logger", "logging_service"), "logging"),
    **dict.fromkeys(("action.graph", "topic_endpoint_info", "type_hash"), "graph"),
    **dict.fromkeys(("clock_type", "constants", "duration"), "time"),
    **dict.fromkeys(("signals", "utilities"), "context"),
    "impl.implementation_singleton": "toplevel",
    "parameter_client": "parameter",
    "parameter_event_handler": "parameter",
    "parameter_service": "impl.node_parameters",
    "qos_event": "event_handler",
    "serialization": "messages",
    "time_source": "clock",
    "type_support": "messages",
}
"""Modules of rclpy, each with the module of turtleact's rclpy that contains its names."""

BESIDE: Final = {
    "ament_index_python": "ament_index",
    "ament_index_python.packages": "ament_index",
    "rosidl_runtime_py": "rosidl_runtime",
    "rosidl_runtime_py.convert": "rosidl_runtime",
    "rosidl_runtime_py.set_message": "rosidl_runtime",
    "rosidl_runtime_py.utilities": "rosidl_runtime",
}
"""Modules of other ROS packages, each with the turtleact module that takes its place."""

MISSING: Final = {
    "tf2_ros": "tf2 is not part of turtleact",
    "tf2_py": "tf2 is not part of turtleact",
    "tf2_geometry_msgs": "tf2 is not part of turtleact",
    "launch": "start each program by itself; 'turtleact pkg executables' lists what can be run",
    "launch_ros": "start each program by itself; 'turtleact pkg executables' lists what can be run",
    "rclpy.experimental": "use a SingleThreadedExecutor or a MultiThreadedExecutor",
    "rclpy.type_adapter": "turtleact has no type adapters",
}
"""The modules that turtleact does not have, and the reason or advice in the error for each."""


LONGEST: Final = 3.0
"""How long an import may wait for the graph (s)."""


PROBLEMS: Final[dict[str, TurtleactError]] = {}
"""Why types could not be learned. Python looks twice for a name, and nobody is asked twice."""


class Finder(MetaPathFinder):
    """Finds the modules that turtleact provides.

    The finder looks up the packages with interfaces once, when it is made, because the look-up
    itself imports modules.
    """

    def __init__(self, places: Sequence[str] = ()) -> None:
        self._places = tuple(dict.fromkeys(places))
        self._packages = frozenset(name.partition("/")[0] for name in known_interfaces())
        self._learned = frozenset(name.partition("/")[0] for name in cached_names())

    def find_spec(
        self,
        fullname: str,
        path: Sequence[str] | None,  # noqa: ARG002  # our modules are in no folder
        target: ModuleType | None = None,  # noqa: ARG002  # nothing is reloaded
    ) -> ModuleSpec | None:
        """Return the spec of a module, or None to leave the module to other finders.

        Raises:
            ImportError: if the module is a part of ROS that turtleact does not have.
        """
        if fullname in MISSING:
            raise ImportError(f"turtleact has no '{fullname}': {MISSING[fullname]}", name=fullname)
        top, _, rest = fullname.partition(".")
        if top == "rclpy":
            return self._of_rclpy(fullname, rest)
        if fullname in BESIDE:
            return _spec(fullname, _Alias(f"{OURS}.{BESIDE[fullname]}"), is_package=not rest)
        if top not in self._packages and not self._may_learn(top, rest):
            return None
        if rest in KINDS:
            return _spec(fullname, _Interfaces(top, rest), is_package=True)
        kind, _, name = rest.partition(".")
        if kind in KINDS and not name.startswith("_"):
            _check_known(top, kind, name)
        if not rest and top not in self._packages:
            return _spec(fullname, _LearnedPackage(self._places), is_package=True)
        if not rest and not _is_users_own(top):
            return _spec(fullname, _Package(), is_package=True)
        return None

    def _may_learn(self, package: str, rest: str) -> bool:
        """Whether nothing installed provides a package whose interfaces may be learned."""
        is_wanted = not rest or rest.partition(".")[0] in KINDS
        is_one = package in self._learned or package.endswith(SUFFIXES)
        return is_one and is_wanted and PathFinder.find_spec(package) is None

    def _of_rclpy(self, fullname: str, rest: str) -> ModuleSpec | None:
        ours = f"{OURS}.{ALIASES.get(rest, rest)}" if rest else f"{OURS}.toplevel"
        found = find_spec(ours)
        if found is None:
            return None
        is_package = not rest or found.submodule_search_locations is not None
        return _spec(fullname, _Alias(ours), is_package=is_package)


class _Alias(Loader):
    """Makes a module of turtleact importable under a second name.

    Args:
        name: The full name of the module in turtleact.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._spec: ModuleSpec | None = None

    def create_module(self, spec: ModuleSpec) -> ModuleType:  # noqa: ARG002  # the module exists
        """Import the module under its full name, and return it."""
        module = import_module(self._name)
        self._spec = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Restore the spec that the import system has replaced. Do not run the code again."""
        module.__spec__ = self._spec


class _Package(Loader):
    """Makes the package that contains the modules ``msg``, ``srv`` and ``action``."""

    def exec_module(self, module: ModuleType) -> None:
        """Do nothing, because the package itself defines no names."""


class _LearnedPackage(_Package):
    """Makes a package whose interfaces are learned from the graph.

    Args:
        places: The places that were searched for interfaces.
    """

    def __init__(self, places: Sequence[str]) -> None:
        self._places = places

    def exec_module(self, module: ModuleType) -> None:
        """Learn the types of the package, or raise `ModuleNotFoundError`."""
        if not _learn_package(module.__name__):
            raise _nowhere(module.__name__, self._places)


class _Interfaces(Loader):
    """Loads ``PKG.msg``, ``PKG.srv`` or ``PKG.action``.

    The loaded module makes each class on its first use.

    Args:
        package: The name of the package.
        kind: ``msg``, ``srv`` or ``action``.
    """

    def __init__(self, package: str, kind: str) -> None:
        self._prefix = f"{package}/{kind}/"

    def exec_module(self, module: ModuleType) -> None:
        """Define the module's ``__all__``, ``__dir__`` and ``__getattr__``.

        The function ``__getattr__`` makes the classes.
        """
        prefix = self._prefix
        known = {*known_interfaces(), *cached_names()}
        known = {name for name in known if name.startswith(prefix)}
        names = [name.removeprefix(prefix) for name in known]

        def get(name: str) -> object:
            from turtleact.rclpy.messages import interface_class  # programs may need none

            if name.startswith("_"):
                raise AttributeError(f"module '{module.__name__}' has no attribute '{name}'")
            try:
                _learn(f"{prefix}{name}")
                found: object = interface_class(f"{prefix}{name}")
            except TurtleactError as error:
                text = f"module '{module.__name__}' has no attribute '{name}': {error}"
                raise AttributeError(text) from error
            setattr(module, name, found)
            return found

        module.__dict__["__all__"] = sorted(names)
        module.__dict__["__getattr__"] = get
        module.__dict__["__dir__"] = lambda: sorted(names)


class _Missing(MetaPathFinder):
    """Raises an error for a package with unknown interfaces. Python asks this finder last.

    The error lists the places that were searched for interfaces.

    Args:
        places: The places that were searched for interfaces.
    """

    def __init__(self, places: Sequence[str]) -> None:
        self._places = tuple(dict.fromkeys(places))

    def find_spec(
        self,
        fullname: str,
        path: Sequence[str] | None,  # noqa: ARG002  # as above
        target: ModuleType | None = None,  # noqa: ARG002  # as above
    ) -> None:
        """Raise `ModuleNotFoundError` for a name that looks like a package with interfaces."""
        top, _, rest = fullname.partition(".")
        if rest in KINDS or (not rest and top.endswith(SUFFIXES)):
            raise _nowhere(fullname, self._places)


def _nowhere(name: str, places: Sequence[str]) -> ModuleNotFoundError:
    """Return the error for a package whose interfaces are not known."""
    top = name.partition(".")[0]
    said = "".join(f"\n  {place}" for place in places)
    return ModuleNotFoundError(
        f"No module named '{name}'. Its interfaces ({top}/msg, {top}/srv, "
        f"{top}/action) are in none of these places:{said}\n"
        "Source the ROS workspace that has them, or give --interfaces DIR",
        name=name,
    )


def _spec(name: str, loader: Loader, *, is_package: bool) -> ModuleSpec:
    return ModuleSpec(name, loader, origin="turtleact", is_package=is_package)


def _check_known(package: str, kind: str, name: str) -> None:
    """Check that a package has an interface.

    Python looks for a module ``std_msgs.msg.Strng`` after ``from std_msgs.msg import Strng`` has
    found no attribute of this name. Otherwise, the error would not say which names are similar.

    Raises:
        ImportError: if there is no such interface, or the file that defines it is malformed.
    """
    type_name = f"{package}/{kind}/{name}"
    try:
        if type_name in PROBLEMS:
            raise PROBLEMS[type_name]
        find_interface(type_name)
    except TurtleactError as error:
        text = f"cannot import name '{name}' from '{package}.{kind}': {error}"
        raise ImportError(text, name=f"{package}.{kind}.{name}") from None


def _learn(type_name: str) -> None:
    """Make sure that an interface is known. Learn it if nothing installed has its package.

    Raises:
        TurtleactError: if it is not known and cannot be learned, or its file is malformed.
    """
    try:
        get_interface(type_name)
    except UnknownInterface:
        package = type_name.partition("/")[0]
        is_installed = any(name.startswith(f"{package}/") for name in known_interfaces())
        if is_installed or not type_name_pattern.fullmatch(type_name):
            raise
        _learn_import(type_name)


def _learn_import(type_name: str) -> None:
    """Learn a type, so that `turtleact.interfaces.loading.find_interface` finds it.

    Raises:
        TurtleactError: if neither the cache nor a node on the graph describes the type, or if there
            are several versions of it. The error lists them.
    """
    if type_name in PROBLEMS:
        raise PROBLEMS[type_name]
    if len({type_hash(each) for each in learned_classes(type_name)}) == 1:
        return
    try:
        _on_graph(lambda learner: learner.learn_type(type_name), type_name)
    except TurtleactError as error:
        PROBLEMS[type_name] = error
        raise


@cache
def _learn_package(package: str) -> bool:
    """Learn the types of a package, and return whether there are any.

    A type of which the cache has several versions is left to `_learn_import`, which asks the graph.
    """

    async def learn(learner: Learner) -> None:
        def wants(kind: Kind, name: str) -> bool:
            uses = learner.uses(name, kind)
            return any(use.type_name.startswith(f"{package}/") for use in uses)

        await learner.learn_all(wants)

    if not _cached(package):
        with suppress(TurtleactError):
            _on_graph(learn, package)
    for name in _cached(package):
        versions = list(cached(name))
        if len(versions) == 1:
            remember(versions[0])
    return bool(_cached(package))


def _cached(package: str) -> list[str]:
    return [name for name in cached_names() if name.startswith(f"{package}/")]


def _on_graph(learn: Callable[[Learner], Awaitable[object]], what: str) -> None:
    """Open a session, and learn from the graph in it.

    Raises:
        TurtleactError: if no graph is in reach, or the types cannot be learned in time.
    """
    import anyio  # few programs learn a type, and these are slow to import

    from turtleact.node import open_node
    from turtleact.transports import open_zenoh

    place, domain = SETTINGS.place, int(os.environ.get("ROS_DOMAIN_ID", "0"))
    problems: list[TurtleactError] = [NotLearned(what, f"no answer within {LONGEST:g} s")]

    async def ask() -> None:
        with anyio.move_on_after(LONGEST):
            try:
                graph = open_zenoh(place.connect or None, domain=domain, config=place.config)
                async with graph as transport, open_node("_import", transport=transport) as node:
                    await transport.explore()
                    await learn(node.learner)
                problems.clear()
            except TurtleactError as error:
                problems[:] = [error]

    asking = threading.Thread(target=anyio.run, args=(ask,))
    asking.start()  # a thread of its own, because this one may run an event loop
    asking.join()
    if problems:
        raise problems[0]


def _is_users_own(package: str) -> bool:
    """Whether Python finds a package of this name without ``msg``, ``srv`` and ``action``."""
    found = PathFinder.find_spec(package)
    if found is None or found.origin is None:  # none, or a folder without __init__.py
        return False
    made = (PathFinder.find_spec(kind, found.submodule_search_locations) for kind in KINDS)
    return not any(each is not None and each.origin is not None for each in made)


def install(places: Sequence[str] = ()) -> None:
    """Make imports find turtleact's modules before other modules of the same names.

    Args:
        places: The places that were searched for interfaces. Error messages list them.
    """
    uninstall()
    sys.meta_path.insert(0, Finder(places))
    sys.meta_path.append(_Missing(places))


def uninstall() -> None:
    """Undo `install`. Modules that are already imported stay imported."""
    sys.meta_path[:] = [each for each in sys.meta_path if not isinstance(each, Finder | _Missing)]
