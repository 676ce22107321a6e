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
