"""What simulators are asked for and answer, as classes.

Source: package ``simulation_interfaces`` 2.1.0.
"""

from __future__ import annotations

from typing import ClassVar

from msgspec import field

from turtleact.interfaces.types import Action, Message, Service, string, uint8, uint16, uint64

__all__ = [
    "GetSimulationState",
    "GetSimulatorFeatures",
    "ResetSimulation",
    "SetSimulationState",
    "SimulateSteps",
    "SimulationResult",
    "SimulationState",
    "SimulatorFeatures",
    "StepSimulation",
]


class SimulationResult(Message, type_name="simulation_interfaces/msg/Result"):
    """What came of a request: a number, and what is wrong in words."""

    RESULT_FEATURE_UNSUPPORTED: ClassVar[uint8] = 0
    RESULT_OK: ClassVar[uint8] = 1
    RESULT_NOT_FOUND: ClassVar[uint8] = 2
    RESULT_INCORRECT_STATE: ClassVar[uint8] = 3
    RESULT_OPERATION_FAILED: ClassVar[uint8] = 4

    result: uint8 = 0
    error_message: string = ""


class SimulationState(Message, type_name="simulation_interfaces/msg/SimulationState"):
    """Whether simulated time passes."""

    STATE_STOPPED: ClassVar[uint8] = 0
    STATE_PLAYING: ClassVar[uint8] = 1
    STATE_PAUSED: ClassVar[uint8] = 2
    STATE_QUITTING: ClassVar[uint8] = 3
    STATE_NO_WORLD: ClassVar[uint8] = 4
    STATE_LOADING_WORLD: ClassVar[uint8] = 5

    state: uint8 = 0


class SimulatorFeatures(Message, type_name="simulation_interfaces/msg/SimulatorFeatures"):
    """What a simulator can do."""

    SPAWNING: ClassVar[uint8] = 0
    DELETING: ClassVar[uint8] = 1
    NAMED_POSES: ClassVar[uint8] = 2
    POSE_BOUNDS: ClassVar[uint8] = 3
    ENTITY_TAGS: ClassVar[uint8] = 4
    ENTITY_BOUNDS: ClassVar[uint8] = 5
    ENTITY_BOUNDS_BOX: ClassVar[uint8] = 6
    ENTITY_BOUNDS_CONVEX: ClassVar[uint8] = 7
    ENTITY_CATEGORIES: ClassVar[uint8] = 8
    SPAWNING_RESOURCE_STRING: ClassVar[uint8] = 9
    ENTITY_STATE_GETTING: ClassVar[uint8] = 10
    ENTITY_STATE_SETTING: ClassVar[uint8] = 11
    ENTITY_INFO_GETTING: ClassVar[uint8] = 12
    ENTITY_INFO_SETTING: ClassVar[uint8] = 13
    SPAWNABLES: ClassVar[uint8] = 14
    SIMULATION_RESET: ClassVar[uint8] = 20
    SIMULATION_RESET_TIME: ClassVar[uint8] = 21
    SIMULATION_RESET_STATE: ClassVar[uint8] = 22
    SIMULATION_RESET_SPAWNED: ClassVar[uint8] = 23
    SIMULATION_STATE_GETTING: ClassVar[uint8] = 24
    SIMULATION_STATE_SETTING: ClassVar[uint8] = 25
    SIMULATION_STATE_PAUSE: ClassVar[uint8] = 26
    STEP_SIMULATION_SINGLE: ClassVar[uint8] = 31
    STEP_SIMULATION_MULTIPLE: ClassVar[uint8] = 32
    STEP_SIMULATION_ACTION: ClassVar[uint8] = 33
    WORLD_LOADING: ClassVar[uint8] = 40
    WORLD_RESOURCE_STRING: ClassVar[uint8] = 41
    WORLD_TAGS: ClassVar[uint8] = 42
    WORLD_UNLOADING: ClassVar[uint8] = 43
    WORLD_INFO_GETTING: ClassVar[uint8] = 44
    AVAILABLE_WORLDS: ClassVar[uint8] = 45
    SPAWNING_ENTITIES: ClassVar[uint8] = 50

    features: list[uint16] = field(default_factory=list)
    spawn_formats: list[string] = field(default_factory=list)
    custom_info: string = ""


class GetSimulatorFeatures(Service, type_name="simulation_interfaces/srv/GetSimulatorFeatures"):
    """Tells what the simulator can do."""

    class Request(Message):
        """Nothing."""

    class Response(Message):
        """What it can do."""

        features: SimulatorFeatures = field(default_factory=SimulatorFeatures)


class GetSimulationState(Service, type_name="simulation_interfaces/srv/GetSimulationState"):
    """Tells whether simulated time passes."""

    class Request(Message):
        """Nothing."""

    class Response(Message):
        """The state."""

        state: SimulationState = field(default_factory=SimulationState)
        result: SimulationResult = field(default_factory=SimulationResult)


class SetSimulationState(Service, type_name="simulation_interfaces/srv/SetSimulationState"):
    """Pauses, stops, or plays."""

    class Request(Message):
        """The state that is wanted."""

        state: SimulationState = field(default_factory=SimulationState)

    class Response(Message):
        """What came of it."""

        ALREADY_IN_TARGET_STATE: ClassVar[uint8] = 101
        STATE_TRANSITION_ERROR: ClassVar[uint8] = 102
        INCORRECT_TRANSITION: ClassVar[uint8] = 103

        result: SimulationResult = field(default_factory=SimulationResult)


class StepSimulation(Service, type_name="simulation_interfaces/srv/StepSimulation"):
    """Lets some steps pass while the simulation is paused."""

    class Request(Message):
        """How many steps."""

        steps: uint64 = 1

    class Response(Message):
        """What came of it, after the last step."""

        result: SimulationResult = field(default_factory=SimulationResult)


class ResetSimulation(Service, type_name="simulation_interfaces/srv/ResetSimulation"):
    """Takes the simulation back to its start."""

    class Request(Message):
        """What of it: bits."""

        SCOPE_DEFAULT: ClassVar[uint8] = 0
        SCOPE_TIME: ClassVar[uint8] = 1
        SCOPE_STATE: ClassVar[uint8] = 2
        SCOPE_SPAWNED: ClassVar[uint8] = 4
        SCOPE_ALL: ClassVar[uint8] = 255

        scope: uint8 = 0

    class Response(Message):
        """What came of it."""

        result: SimulationResult = field(default_factory=SimulationResult)


class SimulateSteps(Action, type_name="simulation_interfaces/action/SimulateSteps"):
    """Lets some steps pass while the simulation is paused."""

    class Goal(Message):
        """How many steps."""

        steps: uint64 = 0

    class Result(Message):
        """What came of it."""

        result: SimulationResult = field(default_factory=SimulationResult)

    class Feedback(Message):
        """Steps made, and steps to make."""

        completed_steps: uint64 = 0
        remaining_steps: uint64 = 0
