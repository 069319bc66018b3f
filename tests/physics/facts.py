"""What the robots are made of, by the numbers of the experiments' descriptions."""

import math
from typing import Any, NamedTuple

import mujoco
import numpy as np

KINDS = mujoco.mjtObj
PLANE, SPHERE, CAPSULE, CYLINDER, BOX = (
    getattr(mujoco.mjtGeom, f"mjGEOM_{kind}")
    for kind in ("PLANE", "SPHERE", "CAPSULE", "CYLINDER", "BOX")
)
FREE, SLIDE, HINGE = (
    getattr(mujoco.mjtJoint, f"mjJNT_{kind}") for kind in ("FREE", "SLIDE", "HINGE")
)
X, Y, Z = np.eye(3)


class Facts(NamedTuple):
    """What a model must be."""

    names: dict[mujoco.mjtObj, list[str]]
    masses: dict[str, float]
    """By body; all others have none."""
    inertias: dict[str, np.ndarray]
    """By body: the tensor about the centre of mass, along the body's axes."""
    geoms: dict[str, tuple[Any, Any, Any]]
    """Type, sizes and place in the world."""
    bodies: dict[str, Any]
    """Place in the world."""
    untouched: list[bool]
    """Of two geoms that are both such, neither meets the other."""


def ball(radius: float) -> float:
    return 4 / 3 * math.pi * radius**3


def box_inertia(mass: float, half_sizes: Any) -> np.ndarray:
    a, b, c = np.square(half_sizes)
    return mass / 3 * np.diag([b + c, a + c, a + b])


def capsule_mass(density: float, radius: float, length: float) -> float:
    return density * (math.pi * radius**2 * length + ball(radius))


def capsule_inertia(density: float, radius: float, length: float, direction: Any) -> np.ndarray:
    """A cylinder and two half balls, whose centres of mass are 3/8 r beyond their flat sides."""
    cylinder, ends = density * math.pi * radius**2 * length, density * ball(radius)
    along = cylinder * radius**2 / 2 + ends * 2 / 5 * radius**2
    offset = length / 2 + 3 / 8 * radius
    # A half ball about its own centre of mass: 83/320 m r^2 across.
    across = cylinder * (radius**2 / 4 + length**2 / 12) + ends * (83 / 320 * radius**2 + offset**2)
    unit = np.asarray(direction, float) / np.linalg.norm(direction)
    return across * np.eye(3) + (along - across) * np.outer(unit, unit)


# Of the wheeled robot: the whole was scaled to 14 kg when it still had a ball as its goal.
CAR, RADIUS, HALF_LENGTH, TRACK = (0.15, 0.1, 0.046), 0.1, 0.046, 0.2
CAR_VOLUME, WHEEL_VOLUME = 8 * math.prod(CAR), math.pi * RADIUS**2 * 2 * HALF_LENGTH
WHEELED_DENSITY = 14.0 / (CAR_VOLUME + 2 * WHEEL_VOLUME + ball(0.1))
CAR_MASS, WHEEL_MASS = WHEELED_DENSITY * CAR_VOLUME, WHEELED_DENSITY * WHEEL_VOLUME
WHEEL_SPIN = WHEEL_MASS * RADIUS**2 / 2
WHEEL_TURN = WHEEL_MASS * (3 * RADIUS**2 + (2 * HALF_LENGTH) ** 2) / 12
WHEELS = ["right_wheel", "left_wheel"]
WHEEL = np.diag([WHEEL_TURN, WHEEL_SPIN, WHEEL_TURN])

WHEELED = Facts(
    names={
        KINDS.mjOBJ_JOINT: ["x", "y", "z", "yaw", *WHEELS],
        KINDS.mjOBJ_GEOM: ["floor", "car", *WHEELS],
    },
    masses={"car": CAR_MASS} | dict.fromkeys(WHEELS, WHEEL_MASS),
    inertias={"car": box_inertia(CAR_MASS, CAR)} | dict.fromkeys(WHEELS, WHEEL),
    geoms={
        "floor": (PLANE, [40, 40], [0, 0, 0]),
        "car": (BOX, CAR, [0, 0, 0.2]),
        "right_wheel": (CYLINDER, [RADIUS, HALF_LENGTH], [0, -TRACK, RADIUS]),
        "left_wheel": (CYLINDER, [RADIUS, HALF_LENGTH], [0, TRACK, RADIUS]),
    },
    bodies={"car": [0, 0, -0.4]},
    untouched=[False, True, True, True],
)

# Of the ant.
ANT_DENSITY, TORSO, TUBE = 5.0, 0.25, 0.08
DIRECTIONS = {1: (1, 1, 0), 2: (-1, 1, 0), 3: (-1, -1, 0), 4: (1, -1, 0)}
LENGTHS = {"leg": 0.2 * math.sqrt(2), "thigh": 0.2 * math.sqrt(2), "shin": 0.4 * math.sqrt(2)}
PARTS = [(part, leg) for leg in DIRECTIONS for part in LENGTHS]
MOTORS = [f"{joint}_{leg}" for leg in (4, 1, 2, 3) for joint in ("hip", "ankle")]
SIDE, UP, DOWN = math.sqrt(0.5), np.deg2rad([30, 70]), np.deg2rad([-70, -30])
RIGHT, LEFT = [-SIDE, SIDE, 0], [SIDE, SIDE, 0]
HIP = np.deg2rad([-30, 30])


def part_of_the_ant(part: str, leg: int, share: float) -> np.ndarray:
    """A place along a part, in the world: 0 where it begins, 1 where it ends."""
    begin = 0.2 * list(LENGTHS).index(part) * np.asarray(DIRECTIONS[leg])
    along = share * LENGTHS[part] * np.asarray(DIRECTIONS[leg]) / math.sqrt(2)
    return begin + along + 0.55 * Z


ANT = Facts(
    names={
        KINDS.mjOBJ_JOINT: [
            "root",
            *(f"{name}_{leg}" for leg in DIRECTIONS for name in ("hip", "ankle")),
        ],
        KINDS.mjOBJ_BODY: ["world", "torso", *(f"{part}_{leg}" for part, leg in PARTS), "goal"],
        KINDS.mjOBJ_GEOM: ["floor", "torso", *(f"{part}_{leg}" for part, leg in PARTS)],
        KINDS.mjOBJ_ACTUATOR: MOTORS,
    },
    masses={"torso": ANT_DENSITY * ball(TORSO)}
    | {f"{part}_{leg}": capsule_mass(ANT_DENSITY, TUBE, LENGTHS[part]) for part, leg in PARTS},
    inertias={"torso": 2 / 5 * ANT_DENSITY * ball(TORSO) * TORSO**2 * np.eye(3)}
    | {
        f"{part}_{leg}": capsule_inertia(ANT_DENSITY, TUBE, LENGTHS[part], DIRECTIONS[leg])
        for part, leg in PARTS
    },
    geoms={
        f"{part}_{leg}": (CAPSULE, [TUBE, LENGTHS[part] / 2], part_of_the_ant(part, leg, 0.5))
        for part, leg in PARTS
    },
    bodies={"torso": 0.55 * Z}
    | {f"{part}_{leg}": part_of_the_ant(part, leg, 0.0) for part, leg in PARTS},
    untouched=[False] + [True] * 13,
)

# Of block pushing. The gripper lies level, in a plane above the table.
BLOCKS = [f"block_{index}" for index in range(5)]
BLOCK, BLOCK_DENSITY, GRIPPER_DENSITY, ARM, TIP = (0.03, 0.03, 0.05), 0.0005, 10.0, 0.02, 0.01
BLOCK_MASS = BLOCK_DENSITY * 8 * math.prod(BLOCK)
# Length, direction and middle of its capsules, and the middles of the balls at their ends.
CAPSULES = {
    "crossbar": (0.2, Y, [0, 0, -0.263]),
    "right_arm": (0.1, X, [0.05, -0.1, -0.263]),
    "left_arm": (0.1, X, [0.05, 0.1, -0.263]),
}
TIPS = {"right_tip": [0.1, -0.1, -0.263], "left_tip": [0.1, 0.1, -0.263]}
TIP_MASS = GRIPPER_DENSITY * ball(TIP)
GRIPPER_MASS = 2 * TIP_MASS + sum(
    capsule_mass(GRIPPER_DENSITY, ARM, length) for length, _, _ in CAPSULES.values()
)

BLOCKPUSH = Facts(
    names={
        KINDS.mjOBJ_JOINT: ["x", "y", "angle", *(f"{b}_{axis}" for b in BLOCKS for axis in "xy")],
        KINDS.mjOBJ_GEOM: ["table", *CAPSULES, *TIPS, *BLOCKS],
        KINDS.mjOBJ_BODY: ["world", "goal", "gripper", *BLOCKS],
    },
    masses={"gripper": GRIPPER_MASS} | dict.fromkeys(BLOCKS, BLOCK_MASS),
    inertias=dict.fromkeys(BLOCKS, box_inertia(BLOCK_MASS, BLOCK)),
    geoms={
        name: (CAPSULE, [ARM, length / 2], place) for name, (length, _, place) in CAPSULES.items()
    }
    | {name: (SPHERE, [TIP], place) for name, place in TIPS.items()}
    | {name: (BOX, BLOCK, [0.2 * (i + 1), 0, -0.275]) for i, name in enumerate(BLOCKS)},
    bodies={"gripper": [0, 0, -0.263]},
    untouched=[True] + [False] * 10,
)

FACTS = {"wheeled": WHEELED, "ant": ANT, "blockpush": BLOCKPUSH}
