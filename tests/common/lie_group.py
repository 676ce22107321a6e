"""An oracle for error states: SE_{2+K}(3) by the matrix exponential, and its logarithm.

Tangent vectors are ordered (rotation, velocity, position, ...), as the paper orders xi.
"""

import numpy as np
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from surefoot.estimator.core.lie import gammas, hat
from surefoot.estimator.core.state import retract


def wedge(xi: np.ndarray) -> np.ndarray:
    """xi^ (3+m, 3+m) of xi (3 (1+m),)."""
    m = len(xi) // 3 - 1
    out = np.zeros((3 + m, 3 + m))
    out[:3, :3], out[:3, 3:] = hat(xi[:3]), xi[3:].reshape(m, 3).T
    return out


def se_exp(xi: np.ndarray) -> np.ndarray:
    """exp(xi^) (3+m, 3+m)."""
    return expm(wedge(xi))


def se_log(X: np.ndarray) -> np.ndarray:
    """xi (3 (1+m),) with exp(xi^) = X."""
    phi = so3_log(X[:3, :3])
    left_jacobian = np.empty((3, 3))
    gammas(phi, np.empty((3, 3)), left_jacobian, np.empty((3, 3)))
    return np.concatenate([phi, np.linalg.solve(left_jacobian, X[:3, 3:]).T.ravel()])


def se_inverse(X: np.ndarray) -> np.ndarray:
    """X^-1 (3+m, 3+m)."""
    out = np.eye(len(X))
    out[:3, :3], out[:3, 3:] = X[:3, :3].T, -X[:3, :3].T @ X[:3, 3:]
    return out


def so3_exp(phi: np.ndarray) -> np.ndarray:
    """Rotation matrix (3, 3) of the rotation vector phi (3,) [rad]: Gamma_0."""
    out = np.empty((3, 3))
    gammas(phi, out, np.empty((3, 3)), np.empty((3, 3)))
    return out


def so3_log(R: np.ndarray) -> np.ndarray:
    """Rotation vector (3,) [rad] of R (3, 3)."""
    return Rotation.from_matrix(R).as_rotvec()


def group(mean: np.ndarray) -> np.ndarray:
    """The element of SE_{2+K}(3) in a packed mean (7 + K, 3)."""
    X = np.eye(len(mean) - 2)
    X[:3, :3], X[:3, 3:] = mean[:3], mean[[3, 4, *range(7, len(mean))]].T
    return X


def retracted(mean: np.ndarray, delta: np.ndarray, contacts: int = 0) -> np.ndarray:
    """The packed mean after `retract`."""
    out = mean.copy()
    retract(out, delta, contacts)
    return out


def differences(function, size: int, h: float = 1e-6) -> np.ndarray:
    """Derivative (m, size) of a function of (size,) at zero, by central differences."""
    ends = [(function(h * e), function(-h * e)) for e in np.eye(size)]
    return np.column_stack([(up - down) / (2 * h) for up, down in ends])


def error(estimate: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """The paper's error state of packed means: eta = X_bar X^-1 = exp(xi^), delta b = b_bar - b."""
    xi = se_log(group(estimate) @ se_inverse(group(truth)))
    return np.concatenate([xi[:9], (estimate[5:7] - truth[5:7]).ravel(), xi[9:]])
