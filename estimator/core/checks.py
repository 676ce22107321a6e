"""What the filters accept: arrays of the right shape, finite, and covariances that are definite."""

import numpy as np

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.kernels import kernel

_FLOAT = np.dtype(float)


def numbers(name: str, value, shape: tuple) -> np.ndarray:
    """`value` as a contiguous float array of that shape (-1: any); SurefootError otherwise."""
    try:
        out = np.array(value, dtype=float, order="C")
    except (TypeError, ValueError):
        raise SurefootError(f"{name}: not numbers") from None
    if out.ndim != len(shape) or any(
        s not in (-1, n) for s, n in zip(shape, out.shape, strict=True)
    ):
        wanted = "(" + ", ".join("N" if s == -1 else str(s) for s in shape) + ")"
        raise SurefootError(f"{name}: shape {out.shape} where {wanted} is expected")
    if not np.all(np.isfinite(out)):
        raise SurefootError(f"{name}: has values that are not finite")
    return out


def vector(name: str, value) -> np.ndarray:
    """`numbers(name, value, (3,))`, fast where `value` is a float array already."""
    if _plain(value, (3,)):
        x, y, z = value.tolist()
        # Not a number where one of them is infinite or none itself.
        if (x - x) + (y - y) + (z - z) == 0.0:
            return value
    return numbers(name, value, (3,))


def spd_3(name: str, value) -> np.ndarray:
    """`spd(name, value, 3)`, fast where `value` is a float array already."""
    if _plain(value, (3, 3)) and definite_3(value):
        return value
    return spd(name, value, 3)


def _plain(value, shape: tuple) -> bool:
    return (
        type(value) is np.ndarray
        and value.dtype is _FLOAT
        and value.shape == shape
        and value.flags.carray
    )


@kernel
def definite_3(S) -> bool:
    """Whether S (3, 3) is finite, symmetric and positive definite, by its leading minors."""
    if S[0, 1] != S[1, 0] or S[0, 2] != S[2, 0] or S[1, 2] != S[2, 1]:
        return False
    two = S[0, 0] * S[1, 1] - S[0, 1] ** 2
    three = (
        S[2, 2] * two
        - S[0, 2] * (S[0, 2] * S[1, 1] - S[0, 1] * S[1, 2])
        + S[1, 2] * (S[0, 2] * S[0, 1] - S[0, 0] * S[1, 2])
    )
    return 0.0 < S[0, 0] < np.inf and 0.0 < two < np.inf and 0.0 < three < np.inf


def spd(name: str, value, size: int) -> np.ndarray:
    """`value` as a symmetric positive definite (size, size) array; SurefootError otherwise."""
    out = numbers(name, value, (size, size))
    if np.abs(out - out.T).max() > 1e-9 * np.abs(out).max():
        raise SurefootError(f"{name}: is not symmetric")
    try:
        np.linalg.cholesky(out)
    except np.linalg.LinAlgError:
        raise SurefootError(f"{name}: is not positive definite") from None
    return 0.5 * (out + out.T)


@kernel
def finite_3(x) -> bool:
    """Whether x is three finite numbers."""
    return x.shape[0] == 3 and np.isfinite(x[0]) and np.isfinite(x[1]) and np.isfinite(x[2])


def row_indices(rows, count: int, n: int) -> np.ndarray:
    """Checked row indices (count,), strictly increasing inside [0, n)."""
    rows = np.asarray(rows)
    if rows.shape != (count,):
        raise SurefootError(f"rows: shape {rows.shape} where ({count},) is expected, one a v_I")
    rows = rows.astype(np.int64)
    if count and (rows[0] < 0 or rows[-1] >= n or not np.all(np.diff(rows) > 0)):
        raise SurefootError(f"rows: must increase strictly inside 0..{n - 1}")
    return rows
