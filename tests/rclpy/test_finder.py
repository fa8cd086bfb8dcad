"""What can be imported while the finder is installed."""

import importlib
import sys

import pytest

from turtleact.rclpy.finder import MISSING, install, uninstall

PACKAGES = ("rclpy", "geometry_msgs", "example_interfaces", "ament_index_python", "tf2_ros")


@pytest.fixture(autouse=True)
def _finder():
    before = {name: module for name, module in sys.modules.items() if _is_served(name)}
    for name in before:
        del sys.modules[name]
    install(["/lab/src"])
    yield
    uninstall()
    for name in [name for name in sys.modules if _is_served(name)]:
        del sys.modules[name]
    sys.modules.update(before)


def _is_served(name):
    return name.partition(".")[0] in PACKAGES


def test_rclpys_modules_are_ours_under_a_second_name():
    import turtleact.rclpy.node

    assert importlib.import_module("rclpy.node") is turtleact.rclpy.node
    assert turtleact.rclpy.node.__spec__.name == "turtleact.rclpy.node"


def test_a_module_can_be_used_as_an_attribute():
    rclpy = importlib.import_module("rclpy")
    assert rclpy.qos.QoSProfile(depth=1).depth == 1
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        rclpy.nonsense  # noqa: B018


def test_the_names_that_rclpy_spreads_over_modules_are_found():
    module = importlib.import_module("rclpy.validate_topic_name")
    assert module.validate_topic_name("chatter")


def test_interface_packages_have_their_classes():
    module = importlib.import_module("geometry_msgs.msg")
    assert module.Point(x=1.0).x == 1.0
    assert "Twist" in module.__all__
    assert "Twist" in dir(module)


def test_an_unknown_class_is_an_attribute_error_with_the_nearest():
    module = importlib.import_module("geometry_msgs.msg")
    with pytest.raises(AttributeError, match=r"Pont.*did you mean"):
        module.Pont  # noqa: B018


def test_an_import_of_an_unknown_class_suggests_the_nearest():
    with pytest.raises(ImportError, match=r"cannot import name 'Pont'.*did you mean.*Point'"):
        exec("from geometry_msgs.msg import Pont")  # as a program does
    with pytest.raises(ModuleNotFoundError, match="No module"):
        importlib.import_module("geometry_msgs.msg.Point")


@pytest.mark.parametrize("name", sorted(MISSING))
def test_what_turtleact_does_not_have_says_so(name):
    with pytest.raises(ImportError, match=f"turtleact has no '{name}'"):
        importlib.import_module(name)


def test_a_second_install_replaces_the_first():
    before = len(sys.meta_path)
    install()
    assert len(sys.meta_path) == before


@pytest.mark.parametrize("name", ["attic_interfaces", "ament_index_python.action"])
def test_a_package_without_interfaces_is_said_to_be_in_none_of_the_places(name):
    with pytest.raises(ModuleNotFoundError, match=rf"No module named '{name}'.*\n  /lab/src"):
        importlib.import_module(name)
