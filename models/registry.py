"""Registries of networks and calibration methods: the bundled ones, then those of plug-ins.

Listing them imports neither torch nor any of them.
"""

from surefoot.sim.common.plugins import Registry

ARCHITECTURES = Registry(
    "surefoot.architectures",
    {
        "gru": "surefoot.models.observer.architectures:GRU",
        "mlp": "surefoot.models.observer.architectures:MLP",
        "rnn": "surefoot.models.observer.architectures:RNN",
        "lstm": "surefoot.models.observer.architectures:LSTM",
        "bigru": "surefoot.models.observer.architectures:BiGRU",
        "tcn": "surefoot.models.observer.architectures:TCN",
    },
    needs=("width", "rate", "receptive_field", "causal", "initialise", "forward", "stepper"),
)
"""Name -> class with the interface of surefoot.models.observer.network.Architecture."""

CALIBRATORS = Registry(
    "surefoot.calibrators",
    {
        "conformal": "surefoot.models.calibration.regions:Conformal",
        "outer": "surefoot.models.calibration.regions:Outer",
        "maxnorm": "surefoot.models.calibration.regions:MaxNorm",
        "scenario": "surefoot.models.calibration.scenario_box:ScenarioBox",
    },
    needs=("label", "fit_share", "level", "samples_needed", "fit", "conformalize", "bounds"),
)
"""Name -> class with the interface of surefoot.models.calibration.regions.Calibrator."""

LOSSES = ("mse", "gml")
"""Losses of the training: mean squared error, or Gaussian likelihood, which also predicts a
covariance.
"""
