"""Networks and calibration methods by name: those that come with surefoot, then those users add.

Listing them imports neither torch nor any of them.
"""

from surefoot.sim.common.plugins import Registry

ARCHITECTURES = Registry(
    "surefoot.architectures",
    {
        "gru": "surefoot.models.observer.gru:GRU",
        "mlp": "surefoot.models.observer.architectures:MLP",
        "rnn": "surefoot.models.observer.architectures:RNN",
        "lstm": "surefoot.models.observer.architectures:LSTM",
        "bigru": "surefoot.models.observer.architectures:BiGRU",
        "tcn": "surefoot.models.observer.architectures:TCN",
    },
    needs=("width", "rate", "receptive_field", "causal", "initialise", "forward", "stepper"),
)
"""Each as surefoot.models.observer.network.Architecture has it."""

CALIBRATORS = Registry(
    "surefoot.calibrators",
    {
        "conformal": "surefoot.models.calibration.regions:Conformal",
        "bonferroni": "surefoot.models.calibration.regions:Bonferroni",
        "outer": "surefoot.models.calibration.regions:Outer",
        "maxnorm": "surefoot.models.calibration.regions:MaxNorm",
        "ellipsoid": "surefoot.models.calibration.regions:Ellipsoid",
        "scenario": "surefoot.models.calibration.scenario_box:ScenarioBox",
    },
    needs=("label", "fit_share", "level", "samples_needed", "fit", "conformalize", "bounds"),
)
"""Each as surefoot.models.calibration.regions.Calibrator has it."""

LOSSES = ("mse", "gml")
"""What an observer is trained by: mean squared error, or Gaussian likelihood, which predicts a
covariance too."""
