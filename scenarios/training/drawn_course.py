"""Courses drawn at random: commands of all kinds on level ground, or a lane over what robots climb.

Sizes are for `spot_class`, and are scaled to other robots (`sim.similar_course`).
"""

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import chain, cycle

import numpy as np

from surefoot.sim.ground.terrain import Ground, Patch, Strip
from surefoot.sim.scenario import Ranges, Scenario, Segment

COMMANDS = {
    "forward": (0.35, (0.3, 1.3), 0.05, (0.0, 0.1)),
    "in a curve": (0.25, (0.2, 0.8), 0.1, (0.2, 0.8)),
    "sideways": (0.12, (-0.1, 0.3), 0.35, (0.0, 0.2)),
    "backwards": (0.12, (-0.5, -0.2), 0.1, (0.0, 0.3)),
    "on the spot": (0.08, (0.0, 0.0), 0.0, (0.4, 1.0)),
    "standing": (0.08, (0.0, 0.0), 0.0, (0.0, 0.0)),
}
"""Share of the segments, forward velocity [m/s], largest lateral velocity [m/s], turn rate of
either sign [rad/s].
"""
DURATION = (1.5, 5.0)
"""Duration of a segment [s]."""
RANGES = Ranges(
    mu=(0.6, 1.2),
    speed=(0.9, 1.1),
    period=(0.9, 1.1),
    clearance=(0.85, 1.3),
    gain=(0.8, 1.2),
    payload=(0.0, 3.0),
)
"""What the seed of each walk varies besides; the controller does not know the payload."""
SLIPPERY = (0.12, 0.35)
"""Friction coefficient of sheets."""
RISE = (0.25, 0.8)
"""Height of what is climbed [m]."""
RISER, TREAD = (0.06, 0.11), (0.32, 0.5)
"""Height and depth of steps [m]. A trotting robot falls on risers above about 12 cm."""
SLOPE = (0.05, 0.15)
"""Slope of ramps, rise over run."""
BUMPS, STRETCH = (0.01, 0.035), (4, 8)
"""Height of bumps, and length of the rough stretch [m]."""
CLIMBING, LANE = (0.4, 0.6), (0.5, 1.2)
"""Speeds from a metre before steps to a metre after them, and elsewhere on a lane [m/s]."""
WIDTH, HALF_SIZE = 8.0, 80.0


def drawn_course(name: str, seconds: float, rng: np.random.Generator) -> Scenario:
    """A course of about so many seconds; a generator in the same state draws the same one."""
    endless, ground = (_wander if rng.random() < 0.5 else _lane)(rng)
    segments, total = [], 0.0
    while total < seconds:
        segments.append(next(endless))
        total += segments[-1].duration
    return Scenario(name, tuple(segments), ground, "spot_class", ranges=RANGES)


def _wander(rng: np.random.Generator) -> tuple[Iterator[Segment], Ground]:
    """Commands in any order on level ground, with a sheet ahead and some around."""
    ahead = rng.uniform(2.5, 5.0), 0.0
    around = rng.uniform(-6.0, 6.0, (rng.integers(3), 2)).tolist()
    ground = Ground(0.8, tuple(_sheet(x, y, rng) for x, y in (ahead, *around)), HALF_SIZE)
    return iter(partial(_command, rng), None), ground


def _command(rng: np.random.Generator) -> Segment:
    kinds = list(COMMANDS.values())
    _, forward, lateral, turn = kinds[rng.choice(len(kinds), p=[kind[0] for kind in kinds])]
    turned = float(rng.choice((-1.0, 1.0))) * rng.uniform(*turn)
    return Segment(
        rng.uniform(*DURATION), rng.uniform(*forward), rng.uniform(-lateral, lateral), turned
    )


def _lane(rng: np.random.Generator) -> tuple[Iterator[Segment], Ground]:
    """To and fro along x: up, along a level top, down, over rough ground, maybe over a sheet."""
    rise, stepped = rng.uniform(*RISE), (rng.random(2) < 0.5).tolist()
    (up, steps_up), (down, steps_down) = (_flank(rise, one, rng) for one in stepped)
    a, b, c, d = np.cumsum([2.5, up, rng.uniform(2.0, 4.0), down]).tolist()
    rough = float(np.ceil(d)) + 1.0
    end = rough + float(rng.integers(*STRETCH))
    strips = (
        Strip((a, 0.0), (b, 0.0), WIDTH, (0.0, rise), steps_up),
        Strip((b, 0.0), (c, 0.0), WIDTH, (rise, rise)),
        Strip((c, 0.0), (d, 0.0), WIDTH, (rise, 0.0), steps_down),
        Strip((rough, 0.0), (end, 0.0), WIDTH, rough=rng.uniform(*BUMPS)),
    )
    patches = (_sheet(end + 1.5, 0.0, rng),) if rng.random() < 0.5 else ()
    length = end + 3.0
    steps = [flank for flank, one in zip(((a, b), (c, d)), stepped, strict=True) if one]
    there = [(begin - 1.0, finish + 1.0) for begin, finish in steps]
    back = [(length - finish, length - begin) for begin, finish in reversed(there)]
    ways = cycle((there, back))
    trips = chain.from_iterable(_trip(length, slow, rng) for slow in ways)
    return trips, Ground(0.8, patches, HALF_SIZE, strips)


def _flank(rise: float, stepped: bool, rng: np.random.Generator) -> tuple[float, int]:
    """Length [m] of a way up or down, and the number of its steps; 0 for a ramp."""
    if not stepped:
        return rise / rng.uniform(*SLOPE), 0
    steps = int(np.ceil(rise / rng.uniform(*RISER)))
    return steps * rng.uniform(*TREAD), steps


def _trip(
    end: float, slow: Sequence[tuple[float, float]], rng: np.random.Generator
) -> Iterator[Segment]:
    """Ahead for `end` metres at changing speeds, in the stretches `slow` [m] at those for steps,
    with a pause, and about.
    """
    way = 0.0
    while way < end:
        climbs = any(begin <= way < finish for begin, finish in slow)
        speed = rng.uniform(*(CLIMBING if climbs else LANE))
        following = min((x for one in (*slow, (end,)) for x in one if x > way), default=end)
        seconds = min(rng.uniform(*DURATION), (following - way) / speed + 0.01)
        yield Segment(seconds, speed, rng.uniform(-0.05, 0.05))
        way += speed * seconds
    yield Segment(rng.uniform(0.5, 1.5))
    rate = rng.uniform(0.5, 0.9)
    yield Segment(np.pi / rate, turn=float(rng.choice((-rate, rate))))


def _sheet(x: float, y: float, rng: np.random.Generator) -> Patch:
    size_x, size_y = rng.uniform(1.5, 3.0, 2)
    return Patch(x, y, size_x, size_y, rng.uniform(*SLIPPERY))
