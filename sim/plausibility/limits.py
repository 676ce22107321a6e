"""Limits that several rules of plausibility share."""

SURELY, LIKELY, HARDLY = 0.9, 0.7, 0.5
"""Correlation from which two streams measure the same, surely and likely, and below which they do
not. Clean walks have 0.97 and more (gyros, rates of joints) and 0.8 (accelerometers) with what they
measure, below 0.6 with other axes, since roll and sway are correlated, and 0.87 at most at a delay
of whole strides. Measured drives have 0.7 with their models.
"""
SCALED = 0.1
"""Relative scale error of streams that measure the same; single columns have twice as much. Data
sheets allow 3 %; averages over a stride, filters of drives and lever arms cost several percent.
"""
MENDED = 0.6
"""Share of a mean squared error that a correction may leave. On clean walks and a measured Go1,
each wrong order of legs or contacts has at least 1.66 times as much as the right one; two swapped
axes of a gyro leave 0.15 and 0.52 to 0.56 if corrected; a lever arm where there is none 0.86.
"""
LATE, LATEST = 0.02, 2.0
"""Delay of a reference that is reported [s], at 1 m/s the body moves 2 cm in it, and clocks set by
hand or network are worse (`trace` finds smaller ones as an effect); and the largest that is
searched for, `surefoot align` searches further.
"""
LATE_STREAM, LATEST_STREAM = 0.03, 0.16
"""Smallest delay that is reported of streams that are compared by what they do to legs [s], a tenth
of a stance, and largest that is searched for, before the next step begins. Feet spring back before
they lift, and foot sensors are filtered, by 0.02 on a measured Go1.
"""
FEWEST = 50
"""Least number of times at which streams are compared: a second, two strides."""
MIDDLE = 20.0
"""Length of the section in the middle of a log that is enough for some comparisons [s]: some tens
of strides.
"""
RESTS = 0.02
"""Least range of a joint that moves [rad]: a dozen encoder counts; a joint at rest may stay between
two for seconds.
"""
