"""The constants of a trace, each with its unit and the reason for it."""

from dataclasses import dataclass


@dataclass(frozen=True)
class TraceSettings:
    """Thresholds and constants, chosen on simulated walks before the blind study.

    They go with a log under a model (`evidence.LogUnderModel`), and from there with all that is
    computed from it.
    """

    report_share: float = 0.35
    """Share of each log, at its end, that no fit and no choice sees."""
    turn: float = 4.0
    """s of the blocks that fit and that select in turns: some strides each."""
    gap: float = 0.2
    """s between these blocks, longer than residuals resemble each other."""
    turns: int = 6
    """Blocks that a log has at least: of a short one they are shorter, and the gaps with them."""
    shortest_part: float = 0.5
    """s of residuals with a reference below which a part of the split has too few."""
    shortest: float = 11.5
    """s below which there is too little to split: of a log of 12 s, whose ends have no residual."""
    shortest_fixed: float = 3.0
    """s, of all logs of a machine on a fixed base, every row of which is informative."""
    held_still: float = 0.1
    """rad/s, of the gyro in the mean square, above which no base is held still: a trot has 0.2 and
    more, a bad gyro's bias 0.05."""
    farthest_carried: float = 0.5
    """m that no robot moves whose feet do not step: contacts that never change are then dead."""

    block: float = 2.0
    """s of the blocks that errors and intervals are resampled by: residuals of one step resemble
    the next step's, those of blocks of this length hardly each other."""
    turn_on_limit: float = 4.5
    """Standard deviations of a declared turn-on bias beyond which a bias is an effect."""
    small_change: float = 1e-3
    """Share of a change of readings by which it is differenced where there is no chain rule."""

    outlier: float = 2.5
    """Standard deviations beyond which an entry of the table loses weight."""
    weight_rounds: int = 3
    """Times that weights and noise are estimated in turn: by then they hardly move."""
    slip_outlier: float = 6.0
    """Robust deviations above its foot's median at which a stance is masked."""
    slowest_slip: float = 0.02
    """m/s, below which a standing foot creeps, as compliant contacts do, and does not slide."""
    slides: float = 0.08
    """m/s from which a loaded foot slides for certain: rates of its joints err by less."""
    opposes: float = 0.9
    """Cosine to the direction against its motion, of the ground's force on a foot that slides."""
    slide_gap: float = 0.02
    """s between rows that slide, from which they are two slides."""
    slide_load: float = 0.08
    """Share of the weight that a foot carries of which forces are looked at: of less, the leg's own
    inertia is too much."""
    force_window: float = 0.01
    """s over which these forces and velocities are averaged."""
    fewest_slides: int = 10
    """Slides from which their friction is known."""
    slides_everywhere: float = 0.5
    """Share of a walk's blocks with a slide from which it is not patches that are slippery."""
    held_share: tuple[float, float] = (0.7, 1.1)
    """Of the friction at which feet slide, what feet that hold use at most: nearly all of it on
    slippery ground, 3.3 times as much on legs that give (walks of the Go1's model)."""
    slide_spread: float = 0.4
    """Share of the friction by which its interval may be wide."""
    dry: float = 0.75
    """Share of the declared friction that dry floors have at least: 0.6 of 0.8."""
    push_outlier: float = 6.0
    """Robust deviations above its median from which what is left of the force on the base is an
    outside force."""
    push_share: float = 0.03
    """Share of the weight below which nothing is an outside force: 9 N of 32 kg."""
    push_gap: float = 0.5
    """s between such bins from which they are two pushes, and around one that it may still act."""
    shortest_push: float = 0.1
    """s below which it is one foot that landed badly."""
    pushed_share: float = 0.3
    """Share of a log from which what pushes is no outside force but the robot's own doing."""
    raised: float = 0.001
    """m off its foot's height from which a stance that stands out is on something else: an edge."""

    floor_walks: int = 4
    """Walks of the declared model that the noise floor is from."""
    floor_seconds: float = 12.0
    """s of each of them."""
    floor_friction: float = 0.8
    """Coefficient of friction of their ground."""
    floor_stand: float = 0.5
    """s that they stand before they walk."""
    floor_seed: int = 20_011
    """Of the walks: fixed, so that the floor depends on the logs alone."""
    reading_seed: int = 20_012
    """Of the noise that is added to readings where their own noise is the floor."""
    standing_share: float = 0.999
    """Share of rows with a foot on the ground from which a log is one of standing."""
    coarse_share: float = 0.5
    """Share of rows with a sample of its own below which a reference is coarse."""
    coarse_samples: int = 100
    """Samples of a reference below which its noise cannot be estimated."""

    own_zeros: bool = False
    """Whether zeros and clocks are each run's: of several runs, and where effects are declared."""
    above_floor: float = 5.0
    """How many times its size on walks that lack it an effect must have."""
    certain: float = 0.5
    """Share of that for an effect that every machine has and the model lacks: feet of radius zero
    do not exist. It need not be `worth` its place either."""
    faked_share: float = 0.7
    """Share of the size that contacts fake on such walks that is uncertain: on slippery ground they
    faked a delay of joints four times as long as on the floor's."""
    worth: float = 0.02
    """Share of what is explained so far of the channels that it shows in that a further effect must
    add: what others leave of these because they are not quite right is no effect."""
    clear: float = 20.0
    """Times above its floor from which an effect of `large` share may add less than `worth`: beside
    a very large effect even a large one is little."""
    large: float = 0.2
    """Share of all that is left that makes an effect a large one."""
    most_effects: int = 4
    """Effects that one trace may name."""
    twin_overlap: float = 0.95
    """Overlap (cosine) from which two regressors are hard to distinguish."""
    same: float = 0.99999
    """Overlap from which two regressors are one: what tells them apart is what is free beside one
    of them and not the other, such as a bias beside a scale."""
    settling_rounds: int = 3
    """Times at most that sizes and weights are estimated in turn."""
    settled_share: float = 0.01
    """Share of its size by which an effect may move when these have settled."""

    newton_steps: int = 10
    """Steps of Gauss-Newton: a derivative that noise enters falls short of the size at each."""
    newton_close: float = 1e-3
    """Share of its size by which an effect may still move when Gauss-Newton has converged."""
    newton_far: float = 0.1
    """Share of its size by which an effect may have moved since derivatives were taken."""
    close_behind: float = 0.3
    """Share of the best gain from which a candidate might be better than linear regressors show."""
    contenders: int = 5
    """Candidates that are refined on the residual itself in a round."""
    positive_evidence: float = 2.0
    """Difference of -2 log of a probability from which it is evidence (Kass and Raftery 1995)."""
    same_share: float = 0.5
    """Share of a gain: with less of it than that left, another candidate explains the same."""
    contender_size: float = 2.0
    """How many times its size on walks that lack it a contender must have that earned no place."""

    at_floor: float = 1.05
    """Ratio to the most that the floor's walks reach up to which a channel is at its floor."""
    worse: float = 1.02
    """Ratio of after to before from which a channel got worse."""
    far: float = 3.0
    """Times the floor from which what is left of a channel makes every size uncertain."""
    ahead: float = 0.35
    """Share of a floor's walk, at its end, on which an uneven ground is judged."""
    harm: float = 1.05
    """Ratio of a filter's errors, after to before, from which what was found does harm."""

    curve_degrees: tuple[int, ...] = (2, 3, 4, 5, 6)
    """Of the Legendre polynomials of an angle that is read wrong, over the range that it turns."""
    loaded_degrees: tuple[int, ...] = (1, 2, 3, 4)
    """The same for an error that grows with the torque."""
    curve_worth: float = 0.03
    """Share of what an effect explains that a curve of its joint's angle must add."""
    curve_others: float = 3.0
    """How many times more a curve must explain than the same joint's of legs with nothing found."""
    torque_window: float = 0.03
    """s over which a torque is averaged before it is differentiated."""

    most_regressors: int = 3
    """Regressors that are named for one column of what is left."""
    least_share: float = 0.05
    """Share of a column's rest that a regressor must explain on unseen blocks to be named."""
    harmonics: tuple[int, ...] = (2, 3, 4, 6, 8, 10, 12)
    """Of a joint's turn: what repeats with the turns of a gear or of its motor."""
    settling_times: tuple[int, ...] = (4, 8, 16, 32, 64)
    """s, time constants of what warms up or comes to rest after the log's first row."""


DEFAULT = TraceSettings()
