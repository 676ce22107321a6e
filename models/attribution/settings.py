"""Constants of a trace, each with its unit and reason."""

from dataclasses import dataclass


@dataclass(frozen=True)
class TraceSettings:
    """Thresholds and constants of a trace, chosen on simulated walks before the blind study.

    They are stored with a log under a model (`evidence.LogUnderModel`) and passed on with
    everything computed from it.
    """

    report_share: float = 0.35
    """Share of each log, at its end, that filters run over."""
    split_block: float = 4.0
    """Length of the blocks of which two are fitted on and the third reports [s]: a few strides."""
    split_gap: float = 0.2
    """Gap between these blocks [s], longer than residuals are correlated."""
    fewest_split_blocks: int = 9
    """Minimum number of blocks per log; in a short log, blocks and gaps are shortened."""
    shortest_fixed_block: float = 1.5
    """Minimum length of these blocks of a machine on a fixed base [s]: some swings."""
    shortest_part: float = 0.5
    """Minimum length of a part of the split [s], in residuals with a reference."""
    shortest_log: float = 11.5
    """Minimum length of the logs [s]: a log of 12 s, whose ends have no residual."""
    shortest_fixed_log: float = 3.0
    """The same for a machine on a fixed base, of all logs together: every row is informative
    [s].
    """
    shortest_new_run: float = 1.0
    """The same for the longest of the runs that are compared with earlier ones: some of the windows
    in which torques are averaged [s].
    """
    fixed_base_rate: float = 0.1
    """RMS of the gyro below which a base is taken to be fixed [rad/s]: a trot has at least 0.2, the
    bias of a bad gyro 0.05.
    """
    reach_without_step: float = 0.5
    """Distance that a robot cannot move without stepping; contacts that never change are then dead
    [m].
    """

    block: float = 2.0
    """Length of the blocks of the bootstrap [s]: residuals of one step correlate with the next
    step's, those of blocks of this length hardly.
    """
    difference_step: float = 1e-3
    """Relative step of the finite differences of channels without a chain rule."""

    outlier: float = 2.5
    """Standard deviations beyond which an entry of the table loses weight."""
    weight_rounds: int = 3
    """Iterations of weights and noise, after which they hardly change."""
    slip_outlier: float = 6.0
    """Robust deviations above its foot's median from which a stance is masked."""
    slowest_slip: float = 0.02
    """Speed below which a standing foot creeps on compliant contacts and does not slide [m/s]."""
    sliding_speed: float = 0.08
    """Speed from which a loaded foot certainly slides, above the error of joint rates [m/s]."""
    opposing_cosine: float = 0.9
    """Cosine between the ground's force on a sliding foot and the direction opposite to its
    motion.
    """
    slide_gap: float = 0.02
    """Gap between sliding rows from which they belong to two slides [s]."""
    shortest_slide: float = 0.008
    """Shortest slide [s]: most of `force_window`. A landing foot, and one on a leg that springs,
    seem to slide for less.
    """
    slide_load: float = 0.08
    """Load on a foot, as a share of the weight, below which the leg's inertia spoils its force."""
    force_window: float = 0.01
    """Averaging time of these forces and velocities [s]."""
    fewest_slides: int = 5
    """Number of slides needed to estimate their friction."""
    slides_everywhere: float = 0.5
    """Share of the parts of a walk with a slide from which all the ground is slippery, not patches
    of it.
    """
    used_friction_range: tuple[float, float] = (0.7, 1.1)
    """Range of the friction used without sliding, relative to that of sliding feet: nearly all of
    it on slippery ground, 3.3 times as much on compliant legs (walks of the Go1's model).
    """
    slide_spread: float = 0.1
    """Largest interquartile range of the slides' friction, relative to their median: 0.05 on
    slippery ground, 0.12 on soft ground and more on compliant legs (walks of the models of five
    robots).
    """
    dry_friction_share: float = 0.75
    """Smallest friction of a dry floor, relative to the declared one: 0.6 of 0.8."""
    push_outlier: float = 6.0
    """Robust deviations above its median from which the residual force on the base is external."""
    push_share: float = 0.03
    """Smallest outside force, as a share of the weight: 9 N for 32 kg."""
    push_gap: float = 0.5
    """Gap from which two outside forces are separate, and margin around one in which it may act
    [s].
    """
    shortest_push: float = 0.1
    """Shortest outside force; a single bad touchdown is shorter [s]."""
    pushed_share: float = 0.3
    """Share of a log from which such forces are an error of the robot's model."""
    raised_stance: float = 0.001
    """Deviation of a stance's height from the foot's others from which it is on an edge [m]."""

    floor_walks: int = 4
    """Number of simulated walks for the noise floor."""
    floor_seconds: float = 12.0
    """Length of each of them [s]."""
    floor_friction: tuple[float, ...] = (0.5, 0.7, 0.9, 1.1)
    """Coefficients of friction of their ground: feet creep more where it is low."""
    dry_friction: float = 0.8
    """Coefficient of friction of a dry floor."""
    floor_stand: float = 0.5
    """Time that they stand before walking [s]."""
    floor_seed: int = 20_011
    """Their seed, fixed so that the floor depends on the logs alone."""
    reading_seed: int = 20_012
    """Seed of the noise added to readings where their own noise is the floor."""
    standing_share: float = 0.999
    """Share of rows with ground contact from which a log is one of standing."""
    coarse_share: float = 0.5
    """Share of rows with a sample of their own below which a reference is interpolated."""
    coarse_samples: int = 100
    """Samples of a reference needed to estimate its noise."""

    apparent_size_uncertainty: float = 0.7
    """Relative uncertainty of the apparent size on such walks: on slippery ground, the contacts
    imitated a delay of the joints four times as long as on the floor's.
    """

    settling: float = 4.0
    """Beginning of the floor's walks that does not count for levels [s]: feet are steadier in the
    first steps after standing.
    """
    at_floor_ratio: float = 1.05
    """Ratio to the upper limit of the floor's walks up to which a channel is at its floor."""
    noise_ratio: float = 1.5
    """Ratio to the floor from which a channel is above it, at the lower end of its interval."""
    worse_ratio: float = 1.02
    """Ratio of after to before from which a channel is worse."""
    refuted_ratio: float = 1.1
    """Ratio of after to before from which a channel above all walks of its floor is worse, however
    much these scatter.
    """
    far_ratio: float = 3.0
    """Ratio to the floor from which the remaining residual of a channel makes all sizes
    uncertain.
    """
    harm_ratio: float = 1.05
    """Ratio of a filter's error, after to before, from which compensation makes it worse."""

    curve_degrees: tuple[int, ...] = (2, 3, 4, 5, 6)
    """Degrees of the Legendre polynomials of an encoder error over a joint's range of motion."""
    loaded_degrees: tuple[int, ...] = (1, 2, 3, 4)
    """The same for an error proportional to the torque."""
    curve_worth: float = 0.03
    """Share of what an effect explains that a curve of its joint's angle must add."""
    curve_others: float = 3.0
    """Ratio of a curve's gain to that of the same joint on legs without an effect."""
    torque_window: float = 0.03
    """Averaging time of a torque before differentiation [s]."""

    most_regressors: int = 3
    """Maximum number of regressors for one column of the unexplained residual."""
    least_share: float = 0.05
    """Share of a column's residual that a regressor must add on unseen blocks."""
    harmonics: tuple[int, ...] = (2, 3, 4, 6, 8, 10, 12)
    """Harmonics of a joint's angle, for errors periodic in the turns of a gear or motor."""
    settling_times: tuple[int, ...] = (4, 8, 16, 32, 64)
    """Time constants of warm-up and settling after the log's first row [s]."""


DEFAULT = TraceSettings()
