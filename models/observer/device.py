"""Device on which an observer is trained; it runs on the CPU in any case."""

from __future__ import annotations

import torch

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
