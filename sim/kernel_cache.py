"""Compiled kernels are cached by their own file alone: forget them when a file they call changed.

numba keys its cache on the source file of a kernel. A kernel that calls one of another file keeps
the old machine code of that one after an edit or an upgrade, silently.
"""

import hashlib
from pathlib import Path


def forget_stale_kernels(package: str, *called: str) -> None:
    """Delete the cached kernels beside the package's modules unless its sources are unchanged.

    package: the package's `__file__`; called: those of other packages whose kernels its own call,
    which count as its sources too. A folder that cannot be written keeps no cache either, so
    nothing is done there.
    """
    folder = Path(package).parent
    digest = hashlib.sha256()
    for part in (folder, *(Path(other).parent for other in called)):
        for source in sorted(part.glob("*.py")):
            digest.update(source.name.encode() + source.read_bytes())
    cache = folder / "__pycache__"
    stamp = cache / "kernels.sha256"
    try:
        if stamp.exists() and stamp.read_text() == digest.hexdigest():
            return
        for compiled in [*cache.glob("*.nbi"), *cache.glob("*.nbc")]:
            compiled.unlink(missing_ok=True)
        cache.mkdir(exist_ok=True)
        stamp.write_text(digest.hexdigest())
    except OSError:
        return
