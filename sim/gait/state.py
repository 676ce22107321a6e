"""State that the parts of the gait controller exchange, as named arrays for compiled code."""

from typing import NamedTuple

import numpy as np

from surefoot.sim.robot.kinematics import BaseMotion

SWING, STANCE, REACHING = 0, 1, 2
"""Modes of a leg: in the air, on the ground, late to touch down."""


class Gait(NamedTuple):
    """Gait timing and gains of one robot, SI units."""

    period: float  # s
    duty: float  # share of the period in stance
    clearance: float  # m, of the swing foot
    height: float  # m, base origin over the ground
    mass: float  # kg
    inertia: np.ndarray  # (3,) kg m^2, of the whole robot about its base axes
    com_B: np.ndarray  # (3,) m
    nominal_B: np.ndarray  # (4, 2) m, foothold below each hip, in B
    foot_radius: np.ndarray  # (4,) m
    torque_limit: np.ndarray  # (12,) N m
    foot_mass: float  # kg, of a leg as felt at its foot
    leg_length: float  # m
    start: float  # s, first step
    phase: np.ndarray  # (4,) share of the period by which each leg's stance begins earlier
    capture: float  # s, foothold per velocity error
    course_gain: float  # 1/s, force per velocity error and mass
    level: float  # share of the moment that holds the base level while it is nearly so
    level_gain: float  # 1/s^2, moment per tilt and inertia
    sway: float  # share of the way to the middle of the loaded feet that the pressure goes
    slide_damping: float  # N s/m, on a stance foot that slides
    unloading: float  # share of the stance over which a foot's load comes, and goes
    touchdown_speed: float  # m/s, of a landing foot towards the ground
    liftoff_speed: float  # m/s, upward, with which a foot's swing begins
    liftoff_advance: float  # share of the body's velocity with which it begins
    braking: float  # share of the body's velocity that a landing foot still has
    stiffness: float  # N m/rad, of the joints of standing legs
    damping: float  # N m s/rad, the same
    slip_care: float  # share of the velocity that sliding feet lack which is given up
    # Drawn by a seed (`sim.gait.irregular`); empty where nothing is irregular.
    beats: np.ndarray = np.empty(0)  # (S,) s, when the strides begin
    # m, of each stride, ahead and to the left of the planned ones
    footholds: np.ndarray = np.empty((0, 4, 2))
    # m/s, in B, of the controller's estimate at each tick
    velocity_error: np.ndarray = np.empty((0, 3))
    attitude_error: np.ndarray = np.empty((0, 3))  # rad, of which roll and pitch are used


class LegMemory(NamedTuple):
    """State of the controller between ticks, most of it for each leg."""

    mode: np.ndarray  # (4,) SWING or STANCE
    touched: np.ndarray  # (4,) bool, whether the foot has been loaded since its stance began
    lift_off: np.ndarray  # (4, 3) m, where the foot left the ground, in G
    foothold: np.ndarray  # (4, 3) m, where its centre goes down, in G
    bump: np.ndarray  # (4,) m, height of the swing over the way between them
    planted: np.ndarray  # (4, 3) m, in B, where a foot's centre was when it began to stand
    since: np.ndarray  # (4,) s, when that was; NaN while it does not stand
    slid: np.ndarray  # (2,) s, when a standing foot was last felt to slide, and of the last tick
    way: np.ndarray  # (4,) m, that each foot has slid in the middle of its last stance
    given_up: np.ndarray  # (2,) m/s, in G, of the wanted velocity, because feet slide
    sway: np.ndarray  # (3,) m/s along x and y of G that the body sways at, and s, of the last tick


def standing() -> LegMemory:
    """Memory of a standing robot."""
    return LegMemory(
        mode=np.full(4, STANCE),
        touched=np.zeros(4, dtype=bool),
        lift_off=np.zeros((4, 3)),
        foothold=np.zeros((4, 3)),
        bump=np.zeros(4),
        planted=np.zeros((4, 3)),
        since=np.full(4, np.nan),
        slid=np.array([-np.inf, 0.0]),
        way=np.zeros(4),
        given_up=np.zeros(2),
        sway=np.zeros(3),
    )


class RobotState(NamedTuple):
    """State of the robot at a tick, as the controller knows it."""

    t: float  # s
    base: BaseMotion
    q: np.ndarray  # (12,) rad
    dq: np.ndarray  # (12,) rad/s
    load: np.ndarray  # (4,) N, normal foot forces


class Command(NamedTuple):
    """Commanded motion of the base."""

    v: np.ndarray  # (3,) m/s, in G
    turn: float  # rad/s
    sway: np.ndarray  # (2,) m/s, in G, of the velocity beside: what a stride takes back
    push: np.ndarray  # (2,) m/s^2, in G, its rate


class FootStates(NamedTuple):
    """The four feet at a tick, in G."""

    place: np.ndarray  # (4, 3) m, of the centres
    velocity: np.ndarray  # (4, 3) m/s
    sole_velocity: np.ndarray  # (4, 3) m/s, of the contact points
    jacobian: np.ndarray  # (4, 3, 3) m
    normal: np.ndarray  # (4, 3) of the ground below
    mode: np.ndarray  # (4,) SWING, STANCE or REACHING
    progress: np.ndarray  # (4,) share of the swing or stance that is over
    stride: np.ndarray  # (4,) number of the stride that each is in
