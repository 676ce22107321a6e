"""surefoot with a package of a user's own on the path: a folder below tests/packages."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from surefoot.models.residuals.channels import channels
from surefoot.models.residuals.layout import layout_for
from surefoot.sim.common import plugins

PACKAGES = Path(__file__).resolve().parents[1] / "packages"


@contextmanager
def found(package: str) -> Iterator[None]:
    """tests/packages/PACKAGE, a module and its .dist-info, is found in this process."""
    sys.path.insert(0, str(PACKAGES / package))
    forget_plugins()
    try:
        yield
    finally:
        sys.path.remove(str(PACKAGES / package))
        forget_plugins()


def forget_plugins() -> None:
    """Look for plug-ins anew."""
    for kept in (plugins.plugins, plugins._imported, channels, layout_for):
        kept.cache_clear()
