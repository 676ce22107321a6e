"""Device on which an observer is trained; it runs on the CPU in any case."""

from __future__ import annotations

import torch

from surefoot.models.observer.architectures import GRU
from surefoot.models.observer.network import Network
from surefoot.models.observer.observer import ObserverError

CPU = torch.device("cpu")


def torch_device(name: str) -> torch.device:
    """Torch's device of that name. Raises ObserverError where torch cannot use it here."""
    try:
        device = torch.device(name)
        torch.zeros(1, device=device).item()
    except Exception as error:
        # torch raises many types here, depending on device, build and driver.
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ObserverError(f"device {name}: torch cannot use it here ({reason[:200]})") from None
    return device


class TorchGRU(GRU):
    """The layer with torch's own recurrence, since the compiled one of GRU runs on the CPU only."""

    def forward(self, x: torch.Tensor, h0: torch.Tensor | None = None) -> torch.Tensor:
        h0 = x.new_zeros(x.shape[1], self.features) if h0 is None else h0
        weights = self.weight_ih_l0, self.weight_hh_l0, self.bias_ih_l0, self.bias_hh_l0
        return torch.gru(x, h0[None], weights, True, 1, 0.0, self.training, False, False)[0]


def move(network: Network, device: torch.device) -> None:
    """Move a network to a device, with the recurrence that runs there."""
    for layer in network.modules():
        if isinstance(layer, GRU):
            layer.__class__ = GRU if device.type == CPU.type else TorchGRU
    network.to(device)
