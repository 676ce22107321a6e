"""What residual the declared model leaves by itself: the log's own motion, simulated again."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from models.candidates import Case, Evidence, Key, all_keys, linearise
from models.fitting import Whitened, fit, whiten
from models.masking import trust
from models.residual import BIN, measured_against
from sim.effects import Effect
from sim.errors import SurefootError
from sim.log import Log, reference_velocity
from sim.robot import Robot
from sim.scenario import Scenario, Segment
from sim.sensors import Sensors
from sim.terrain import Ground
from sim.walk import walk

REPEATS = 4
SECONDS = 12.0
"""s of walking in each repeat."""
PIECE = 1.0
"""s over which the log's motion is averaged into one commanded velocity."""
FRICTION = 0.8
SEED = 20_011
STAND = 0.5  # s


Course = tuple[tuple[float, float, float], ...]


@dataclass(frozen=True)
class Floor:
    """The residual of a robot that is as its model says.

    sigma (18,): noise of each column of the residual table, in its unit; walks: the repeats it is
    from, whitened, and evidences, as they are; source: in words; file and courses: the robot and
    the motion that were walked.
    """

    sigma: np.ndarray
    walks: tuple[Whitened, ...]
    evidences: tuple[Evidence, ...]
    source: str
    file: Path | None = None
    courses: tuple[Course, ...] = ()

    def sizes(self, chosen: Sequence[Key], key: Key) -> tuple[float, float]:
        """Mean and spread of the size that `key`, fitted along with `chosen`, has where it is not.

        Contacts that give and creep look a little like effects, the same way on every walk.
        """
        if not self.walks:
            return 0.0, 0.0
        sizes = [fit(walk, [*chosen, key]).sizes[len(chosen)] for walk in self.walks]
        return float(np.mean(sizes)), float(np.std(sizes, ddof=1)) if len(sizes) > 1 else 0.0


def floor_of(logs: Sequence[Log], robot: Robot) -> Floor:
    """Repeats of the logs' own motion by the declared robot, in simulation.

    Each of a few short walks follows a stretch of the reference's body velocities. Seeds are fixed,
    so the floor is a function of the logs. A stretch on which the robot falls is tried again
    slower; where it cannot walk at all, the data sheets' noise alone is the floor.
    """
    return _floor(robot.file, tuple(courses(logs)), logs[0].rate, ())


def floor_with(floor: Floor, effects: Sequence[Effect]) -> Floor:
    """The floor of a robot that has these effects and a model that knows of them.

    An effect on the body changes how feet land, so the model with it leaves another residual than
    the model without. The same floor where nothing but readings changed, or the robot falls.
    """
    bodily = any(type(e).edit_spec is not Effect.edit_spec for e in effects)
    if not bodily or floor.file is None or not floor.walks:
        return floor
    other = _floor(floor.file, floor.courses, 0.0, tuple(effects))
    return other if other.walks else floor


def _floor(
    file: Path, along: tuple[Course, ...], rate: float, effects: tuple[Effect, ...]
) -> Floor:
    found = [_evidence(file, course, SEED + i, effects) for i, course in enumerate(along)]
    evidences = tuple(e for e in found if e is not None)
    if not evidences:
        return Floor(sheet_noise(max(rate, 1.0)), (), (), "data sheets of the declared sensors")
    each = [trust(e, np.full(18, 1e-9)) for e in evidences]
    sigma = np.sqrt(np.mean([t.sigma**2 for t in each], axis=0))
    walks = tuple(whiten(e, trust(e, sigma)) for e in evidences)
    source = f"{len(walks)} simulated walks of the declared model along the log's own course"
    return Floor(sigma, walks, evidences, source, file, along)


def sheet_noise(rate: float) -> np.ndarray:
    """Standard deviation (18,) of a bin's residual from the sensors' noise alone."""
    s, rows = Sensors(), max(1.0, BIN * rate)
    reach = 0.5  # m, from a joint to the foot
    gyro, accel = s.gyro_noise / np.sqrt(BIN), s.accel_noise / np.sqrt(BIN)
    leg = s.velocity_noise * reach * np.sqrt(3 / rows)
    return np.repeat([gyro, accel, leg], [3, 3, 12])


def courses(logs: Sequence[Log]) -> list[Course]:
    """Commanded forward, lateral velocity [m/s] and turn [rad/s] a second, for each repeat."""
    motion = [piece for log in logs for piece in _motion(log)]
    length = max(1, min(round(SECONDS / PIECE), len(motion)))
    starts = np.linspace(0, len(motion) - length, REPEATS).round().astype(int)
    return [tuple(motion[start : start + length]) for start in starts] if motion else []


def _motion(log: Log) -> list[tuple[float, float, float]]:
    t, ok, R, v = log.t, log.ref_ok, log.ref_R_GI, reference_velocity(log)
    yaw = np.unwrap(np.arctan2(R[:, 1, 0], R[:, 0, 0]))
    c, s = np.cos(yaw), np.sin(yaw)
    forward, lateral = c * v[:, 0] + s * v[:, 1], c * v[:, 1] - s * v[:, 0]
    pieces = []
    for begin in np.arange(t[0], t[-1] - PIECE, PIECE):
        rows = np.flatnonzero((t >= begin) & (t < begin + PIECE) & ok)
        if len(rows) < 2 or t[rows[-1]] - t[rows[0]] < 0.5 * PIECE:
            continue
        turn = (yaw[rows[-1]] - yaw[rows[0]]) / (t[rows[-1]] - t[rows[0]])
        # Two decimals: rounding makes equal courses equal, so that they are walked once.
        velocity = forward[rows].mean(), lateral[rows].mean(), turn
        pieces.append(tuple(round(float(x), 2) for x in velocity))
    return pieces


@lru_cache(maxsize=64)
def _evidence(
    file: Path, course: Course, seed: int, effects: tuple[Effect, ...]
) -> Evidence | None:
    robot = Robot.load(file)
    for slower in (1.0, 0.6, 0.3):
        segments = tuple(
            Segment(PIECE, forward * slower, lateral * slower, turn * slower)
            for forward, lateral, turn in course
        )
        scenario = Scenario("floor", segments, Ground(FRICTION), stand=STAND)
        try:
            log = walk(scenario, robot, seed, effects, declared=False)
        except SurefootError:  # fallen, or a size that leaves it no foot
            continue
        return linearise([Case(log, robot, measured_against(log))], effects, all_keys(log))
    return None
