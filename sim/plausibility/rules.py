"""The rules of plausibility, in the order in which they are checked.

A rule is checked only where no earlier rule doubts what it compares. One fault therefore gives one
finding, and a second fault of a log may show only when the first is corrected.
"""

from dataclasses import replace

from surefoot.sim.common.gravity import GRAVITY
from surefoot.sim.log import Log
from surefoot.sim.plausibility import (
    attitude,
    axes,
    clock,
    contacts,
    drives,
    imu,
    joints,
    legs,
    place,
    reference,
    streams,
)
from surefoot.sim.plausibility.finding import Finding, Rule
from surefoot.sim.plausibility.view import LogView
from surefoot.sim.robot.machine import Machine

_UNITS = {"gyro": "rad/s", "accel": "m/s²", "q": "rad"}

RULES = (
    Rule(
        "rows",
        "steps of t with each other and with the log's rate",
        f"{clock.STEP_OFF:.0%} of the rate, {clock.SLOWEST_ROWS:g} to {clock.FASTEST_ROWS:g} Hz; "
        f"{clock.MISSING_ROWS:.0%} of the rows missing, or a gap of {clock.LONGEST_GAP:g} s",
        "loops that wait whole time slices are 1 % slow; filters bridge single rows, nothing can "
        "be interpolated over a tenth of a stride",
        "state the rate that the rows have; record again, or cut the log at the gap",
        (),
        clock.stamps,
    ),
    Rule(
        "speed of time",
        "dq, ref_v and gyro with the change of q, ref_p and ref_q",
        f"all of them off by the same factor, {clock.SPEED_OFF:.0%} or more",
        "one factor for all streams is the clock's: 1 ms taken for 2, rows that were thinned out",
        "mend [source] rate, or the unit of t",
        ("t",),
        clock.speed,
    ),
    Rule(
        "frozen",
        "a sensor with its siblings: other axes, the joint's own rate, other joints",
        f"no change for {streams.FROZEN:g} s (torques {streams.LIMITED:g} s) while they move",
        "half a swing; every sensor has noise",
        "leave the column out, or cut the log there",
        (),
        streams.frozen,
    ),
    Rule(
        "copied",
        "columns of one kind with each other",
        "equal, or of opposite sign, to 1e-9 of their mean square",
        "two sensors have noise of their own",
        "one of two columns of the map names the wrong one of theirs",
        (),
        streams.copies,
    ),
    Rule(
        "overflow",
        "steps of gyro and angles from row to row with the range of their readings",
        f"{streams.LEAST_OVERFLOWS} steps over {streams.FROM_END_TO_END:.0%} of it, not back at "
        "once, of " + ", ".join(f"{most:g} {_UNITS[k]}" for k, most in streams.OVERFLOWS.items()),
        "what has mass passes the middle of a range on its way to the other end",
        "a sensor of larger range, or wider numbers; wrap for angles",
        (),
        streams.overflows,
    ),
    Rule(
        "saturated",
        "readings of IMU and joint rates with their largest",
        f"{streams.CLIPPED} rows at exactly it, and three times as many as near it",
        "a sensor's noise spreads what does not clip",
        "a sensor of larger range; filters take clipped readings for true ones",
        (),
        streams.saturated,
    ),
    Rule(
        "gyro's unit",
        "the gyro's size",
        f"{imu.TUMBLING:g} rad/s root mean square, or 0 throughout",
        "a turn a second for as long as the log lasts is no walk",
        'unit = "deg/s"',
        ("gyro",),
        imu.gyro_unit,
    ),
    Rule(
        "gravity",
        "the mean of the accelerometer with gravity, and its direction with what is up: the "
        "robot's z, else away from the feet, else the reference's",
        f"{imu.ZERO_G:g} m/s² above {GRAVITY:g}, a quarter below; {imu.MOST_LEAN:g}° from up",
        "what stays near the ground feels gravity on average; accelerometers have biases of 80 mg "
        "at worst (MPU-6050 product specification); a robot that turns about on a slope of 35° has "
        "a shorter mean",
        'unit = "g"; sign; offset (twice gravity where the motion has the right sign, see the '
        "evidence); the order of the axes",
        ("accel",),
        imu.gravity,
    ),
    Rule(
        "reference's unit",
        "the median speed of ref_p",
        f"{reference.FASTEST_LEGS:g} m/s",
        "the fastest robot on legs ran at 8.9 m/s (WildCat, Boston Dynamics, 2013)",
        'unit = "mm"',
        ("t", "ref"),
        reference.position,
    ),
    Rule(
        "joints' unit",
        "the size of a leg's angles",
        "median above 2 pi rad",
        "joints of legs do not turn about",
        'unit = "deg"',
        ("q",),
        joints.units,
    ),
    Rule(
        "coarse",
        "readings of gyro, accelerometer and angles with each other",
        "nothing between readings that are "
        + ", ".join(f"{streams.COARSE[k]:g} {u}" for k, u in _UNITS.items())
        + " apart",
        "fifty times what sensors of 16 bits and encoders of 12 bits have",
        "record more digits",
        (),
        streams.coarse,
    ),
    Rule(
        "joint rates",
        "means of dq with changes of q over 60 ms, joint by joint",
        f"a factor off by {joints.RATE_OFF:.0%}; correlation below {joints.RATE_ALIKE:g}",
        "equal by definition; clean walks agree to 1 %",
        "unit, sign or order of the columns",
        ("t", "q", "dq"),
        joints.rates,
    ),
    Rule(
        "spikes",
        "each row with the median of five",
        f"{streams.SPIKE:g} times what one row in a hundred has, and 2 rad/s, 0.15 rad ...; "
        f"{streams.DROPS} rows of exactly 0 between others",
        "nothing with mass leaps for a few milliseconds and back; chatter shows in angles too",
        "leave such rows out before the import",
        ("t", "q", "dq", "tau", "gyro"),
        streams.spikes,
    ),
    Rule(
        "jumps",
        "joints from row to row",
        "two in five leap at one row, to five times what one row in a hundred has",
        "rows are missing there, although stamps are even",
        "record again, with the sensor's own stamps",
        ("t", "q", "foot"),
        clock.leaps,
    ),
    Rule(
        "reference's samples",
        "each step of a reference with those around it",
        "jumps, repeated samples, and stamps that are off by a frame (3 % of the steps)",
        "a body on legs is pushed by less than 150 m/s² and 500 rad/s²; cameras count frames",
        "stamps of the tracker itself; frames in which it lost the body are to be left out",
        ("t", "ref"),
        reference.even_samples,
    ),
    Rule(
        "reference's attitude",
        "the turning of ref_q with the gyro, its vertical with gravity, both as they are and under "
        "other readings (x, y, z, w; world to body; north-east-down; y up), and up to "
        f"{attitude.LATEST:g} s late or early",
        f"a reading that fits where ref_q as it is does not; {attitude.LATE:g} s late; "
        f"{attitude.TILT:g}° from gravity",
        "clean walks correlate by 0.97 and more; at 1 m/s a body is 2 cm further after 0.02 s",
        "the order or sign of ref_q's columns; [reference] offset; surefoot align",
        ("t", "gyro", "ref"),
        reference.attitude,
    ),
    Rule(
        "gyro",
        "the gyro with the turning of ref_q, axis by axis",
        f"correlation above {axes.OTHER:g} with another axis or its negative, {axes.GAIN:g} more "
        f"than with its own; a factor off by {imu.GYRO_SCALED:.0%}; a mean {imu.ZERO_RATE:g} rad/s "
        "off",
        "gyros are true to 3 %, and read 20 deg/s at rest at worst (MPU-6050)",
        "order, sign or unit of the axes; where the accelerometer says the same, imu_orientation",
        ("t", "gyro", "ref"),
        imu.gyro,
    ),
    Rule(
        "gyro's noise",
        "the gyro with itself from row to row",
        f"{imu.NOISY:g} rad/s",
        "data sheets have a twentieth; a body with mass turns smoothly",
        "leave the log out, or the axis; a filter takes such noise for 0.01 rad/s",
        ("t", "gyro"),
        imu.gyro_noise,
    ),
    Rule(
        "accelerometer's noise",
        "the accelerometer with itself from row to row",
        f"{imu.NOISY_ACCEL:g} m/s²",
        "data sheets have a fiftieth, walking robots a quarter, with what shakes them",
        "leave the log out, or the axis; a filter takes such noise for 0.1 m/s²",
        ("t", "accel"),
        imu.accel_noise,
    ),
    Rule(
        "IMU's rows",
        f"the accelerometer's sum over {place.SPEEDING:g} s with changes of velocity of ref_p",
        f"{imu.MISSED:.0%} of these, and {imu.IMPLIED[0]:g} to {imu.IMPLIED[1]:g} times what "
        "independent samples cause",
        "averages over each row give the change of velocity at any rate",
        "log faster, or averages over the rows: filters take rows for such",
        ("t", "accel", "gyro", "ref"),
        imu.sampled,
    ),
    Rule(
        "noise of rates",
        "joint rates with themselves from row to row",
        f"{joints.NOISY_RATE:g} rad/s",
        "encoders of 12 bits, read at 1 kHz and not filtered, have as much",
        "filter them, or leave them out: surefoot derives them from angles, and says so",
        ("t", "dq"),
        joints.rate_noise,
    ),
    Rule(
        "gyro and legs",
        "without a reference: the gyro with the turning of lines between standing feet",
        f"another order or sign of axes that leaves {imu.LEFT:.0%} of what is unexplained, or less",
        "feet that stand do not turn; other axes fit by chance only",
        "order or sign of the axes",
        ("t", "gyro", "contact", "q", "foot"),
        imu.turning_of_legs,
    ),
    Rule(
        "reference's velocity",
        "ref_v with the change of ref_p",
        f"{reference.VELOCITY_OFF:.0%} of its size, or of its mean square",
        "equal by definition, in the axes of the world",
        "unit or order of the axes; leave ref_v out, it is derived then",
        ("t", "ref"),
        reference.velocity,
    ),
    Rule(
        "accelerometer",
        "the accelerometer with gravity and the acceleration of ref_p, in world and body",
        f"correlations as of the gyro; a factor of {1 + imu.SCALED_ACCEL:g}; a mean {imu.ZERO_G:g} "
        "m/s² off",
        "impacts and filters blur accelerations, to factors of 0.6 to 1.2 in clean walks",
        "order or sign of the axes of accel or ref_p, whichever the evidence names",
        ("t", "accel", "gyro", "ref"),
        imu.accelerometer,
    ),
    Rule(
        "reference's point",
        "what the accelerometer differs by from the acceleration of ref_p, with that of another "
        "point of the body",
        f"{place.FARTHEST_POINT:g} m from the IMU, and {place.ARM_EXPLAINS:.0%} explained",
        "ref_p is the IMU's own; markers are where there is room",
        "[reference] p_IM; surefoot align",
        ("t", "accel", "gyro", "ref"),
        place.point,
    ),
    Rule(
        "reference's motion",
        f"changes of speed in the plane over {place.SPEEDING:g} s, of ref_p and of the "
        "accelerometer, where they go together",
        f"{place.SIZE_OFF:.0%} in size, {place.POSITIONS_TURNED:g}° in direction",
        "accelerometers are true to 3 %, and to 1° (MPU-6050): 2 % on a measured Go1",
        "the calibration of the tracker; ref_p and ref_q in one world",
        ("t", "accel", "gyro", "ref"),
        place.motion,
    ),
    Rule(
        "contacts",
        "contacts with each other over time",
        f"none changes, or one does not for {contacts.UNCHANGED:g} s in which the others change "
        f"{contacts.OTHERS_CHANGE} times and more, although the robot walks",
        "a foot of a robot that walks lifts at every stride",
        "the threshold of [contact]; leave a dead contact out",
        ("contact",),
        contacts.dead,
    ),
    Rule(
        "legs",
        "the velocity that the body has if feet in contact stand, leg by leg, with that of the "
        "reference (of each other without one): as they are, with legs exchanged, joints "
        "exchanged or of opposite sign, contacts inverted; all, one leg or contacts alone late",
        f"a reading that leaves {legs.MENDED:g} of the mean square (joints "
        f"{legs.MENDED_JOINTS:g}); {legs.HOPELESS:.0%} of the body's own; not {legs.SIZE[0]:g} to "
        f"{legs.SIZE[1]:g} times as fast",
        "standing feet stand: 0.6 % in simulated walks, 3 to 10 % on a measured Go1, where each "
        "wrong reading has 1.66 times as much at least; legs that roll and give are 0.76 to 1.05 "
        "times as fast",
        "order or sign of the columns, joint_sign, the robot's name",
        ("t", "gyro", "q", "contact", "ref", "foot"),
        legs.kinematics,
    ),
    Rule(
        "joint range",
        "angles of legs with the robot's stops",
        f"{joints.BEYOND:g} rad beyond in {joints.BEYOND_SHARE:.0%} of the rows",
        "zeros are set to some degrees, links bend by less; landings touch stops for an instant",
        "joint_sign, joint_offset, the order of the columns, the robot's name",
        ("q",),
        joints.stops,
    ),
    Rule(
        "flickering",
        "contacts with themselves over time",
        f"{contacts.FLICKERS:g} changes a second",
        "four a second in strides; a sensor about its threshold has many",
        "[contact] debounce, or a threshold that is further from the noise",
        ("t", "contact"),
        contacts.flickering,
    ),
    Rule(
        "missed steps",
        "the number of changes of each contact with that of the others",
        f"less than {contacts.MISSES:g} of it, where the others change {contacts.MOST_SURE} times "
        "or more",
        "in every gait each foot steps once a stride",
        "the threshold of [contact] for that foot",
        ("t", "contact"),
        contacts.missed,
    ),
    Rule(
        "zeros",
        "a left joint with the right one of the same pair of legs",
        " or ".join(f"{x:g} rad" for x in sorted(set(joints.ZERO_OFF.values())))
        + " between medians (hips mirrored), while those of the other pair agree",
        "legs of a pair are held alike; what holds them otherwise does so to both pairs",
        "joint_offset",
        ("q",),
        joints.zeros,
    ),
    Rule(
        "climbing",
        "the reference's vertical velocity with that of standing feet",
        f"{legs.CLIMBS:g} m/s in the median",
        "feet that stand do not sink",
        "another reference; level its world with [reference] q_GW",
        ("t", "gyro", "q", "contact", "ref", "foot", "accel"),
        legs.climbing,
    ),
    Rule(
        "zeros of most legs",
        "the velocity that the body has if feet in contact stand with that of the reference, as "
        "angles are and moved",
        f"{legs.OFFSETS[legs.OFFSETS > 0][0]:g} rad or more, of the same joint of most legs, that "
        f"leave {legs.MENDED:g} of the mean square",
        "zeros are set to some degrees",
        "joint_offset",
        ("t", "gyro", "q", "contact", "ref", "foot"),
        legs.zeros_of_most,
    ),
    Rule(
        "reference from legs",
        "the velocity of ref_p with that by feet in contact",
        f"alike to {place.MADE_OF_LEGS:.0%}",
        "feet roll and slip: 7 % in simulated walks, 15 % on a measured Go1",
        "a reference that was measured; results against this one say how alike estimates are",
        ("t", "gyro", "q", "contact", "ref", "foot"),
        place.from_legs,
    ),
    Rule(
        "contact heights",
        "the height of a foot in contact with that when lifted",
        f"{1e3 * contacts.HIGHER:g} mm higher",
        "trotting robots lift their feet by 30 to 80 mm",
        "contact from the other level of the switch; the order of the legs",
        ("q", "contact", "foot", "accel"),
        contacts.inverted,
    ),
    Rule(
        "torque",
        "torques with what the robot's drives can give",
        f"{joints.TOO_STRONG:g} times as much, one row in a hundred",
        "drives give their peak for seconds at most, and no more",
        'unit = "mN m"; the robot\'s name',
        ("tau",),
        joints.torques,
    ),
    Rule(
        "magnitudes",
        "the signs of torques",
        "none negative",
        "joints of legs push both ways",
        "torques with their signs",
        ("tau",),
        joints.magnitudes,
    ),
    Rule(
        "torques of a fixed base",
        "torques with what the machine's model asks for along the motion, and friction beside it",
        f"correlation below {drives.OPPOSITE:g}; a sign that changes on the way; not "
        f"{drives.SCALED[0]:g} to {drives.SCALED[1]:g} times as large; no change for "
        f"{streams.LIMITED:g} s while {drives.STRAYS:g} times as much is missed as else",
        "three measured machines have 0.6 to 1.3 times what their models ask for",
        "sign, unit or gain of tau; torques of the output, not of the motor",
        ("t", "q", "tau"),
        drives.driving,
    ),
    Rule(
        "support",
        "the weight that torques of legs in contact carry with the robot's",
        f"{legs.SUPPORT[0]:g} to {legs.SUPPORT[1]:g} times",
        "on average a robot carries itself; payloads add a third",
        "sign, unit or order of tau; torques of the output, not of the motor; the robot's name",
        ("q", "contact", "tau", "accel", "foot"),
        legs.weight_carried,
    ),
    Rule(
        "late torques",
        "the forces that torques mean with contacts, over time",
        f"{1e3 * legs.LATE_LOAD:g} ms late or early",
        "a leg is loaded while it stands: 2 ms in clean walks",
        "the filter or clock of tau, or of the contacts",
        ("t", "q", "contact", "tau", "accel", "foot"),
        legs.late_torques,
    ),
    Rule(
        "commands",
        "the size of q_des with that of q",
        "10 times",
        "commands are followed",
        'unit = "deg"',
        ("q",),
        joints.commands,
    ),
    Rule(
        "commands of a fixed base",
        f"q_des with q, joint by joint, and their moves within {drives.MOVE:g} s",
        f"correlation below {drives.OPPOSITE:g}; a sign that changes on the way; not "
        f"{drives.SCALED[0]:g} to {drives.SCALED[1]:g} times as far; no change for "
        f"{drives.COMMANDED:g} s while the joint goes {drives.SWEPT:.0%} of its range, or "
        f"{drives.STRAYS:g} times as far off as else",
        "nothing but its drive moves a joint of an arm as far",
        "sign, unit or gain of q_des",
        ("t", "q", "q_des"),
        drives.followed,
    ),
    Rule(
        "held",
        "rows of a sensor with the rows before",
        f"repeated so often that it has {streams.SLOWER:g} of the rate of the rows",
        "a slower sensor; coarse readings repeat at a sixth of the rows by chance",
        "nothing, if it is known: rates from differences are wrong, noise is less than it seems",
        ("t",),
        streams.held,
    ),
    Rule(
        "interpolated",
        "steps of a sensor from row to row",
        f"{streams.STRAIGHT:.0%} of them as the one before",
        "every sensor has noise",
        "nothing, if it is known: noise is less than it seems, and impacts are missing",
        ("t",),
        streams.interpolated,
    ),
    Rule(
        "late",
        "dq with the change of q, ref_v with that of ref_p",
        f"{1e3 * streams.LATE_RATE:g} ms; {1e3 * attitude.LATE:g} ms",
        "two samples; a filter's delay moves what filters and traces see",
        "nothing, if it is known: trace has rate_delay",
        ("t", "ref"),
        streams.late,
    ),
    Rule(
        "single rows",
        "stamps with even ones",
        f"{clock.MISSING_ROWS:.0%} of the rows missing, without a gap",
        "loops that share a computer are late for some per cent",
        "nothing, if it is known: [even] makes rows even",
        ("t",),
        clock.single_rows,
    ),
    Rule(
        "derived",
        "dq with the difference of q, tau with the motor law",
        "equal to 1e-8 of the mean square",
        "what follows from others is no measurement, and has their errors",
        "leave the column out: surefoot derives it, and says so",
        (),
        streams.derived,
    ),
)
_MINOR = (
    "single rows",
    "reference's samples",
    "saturated",
    "coarse",
    "held",
    "interpolated",
    "late",
)
"""Rules that skip columns in doubt, and put none in doubt themselves."""


def check_log(log: Log, machine: Machine | None = None) -> tuple[Finding, ...]:
    """Find what is implausible in a log; takes about a second per minute of log.

    `machine` is the robot or other machine of the log, None if unknown.
    """
    view = LogView(log, machine)
    found: list[Finding] = []
    doubted: set[str] = set()
    for rule in RULES:
        if rule.asks_of(doubted):
            new = [replace(one, rule=rule.name) for one in rule.find(view)]
            if rule.name in _MINOR:
                found += [one for one in new if not doubted.issuperset(one.streams)]
            else:
                found += new
                doubted.update(*(one.streams for one in new))
    return tuple(found)


def rules_table() -> list[dict[str, str]]:
    """The rules as rows of a table."""
    names = ("name", "compares", "threshold", "reason", "remedy")
    heads = ("rule", "compares", "speaks from", "because", "what to do")
    return [{h: getattr(r, n) for h, n in zip(heads, names, strict=True)} for r in RULES]
