"""Walks during which something else than the ground pushes the robot."""

import numpy as np

from surefoot.sim.log.schema import named_columns


def pushed(log, robot, spans, force):
    """The log of a robot whose feet hold against a force [N], in I, and stand as they did."""
    t = log.t - log.t[0]
    on = np.any([(t > begin) & (t < end) for begin, end in spans], axis=0)
    share = log.contact * on[:, None] / np.maximum(log.contact.sum(axis=1, keepdims=True), 1)
    held = np.einsum("nlik,i->nlk", robot.feet_jacobian_I(log.q), np.asarray(force))
    tau = log.tau + (held * share[..., None]).reshape(log.tau.shape)
    return log.with_columns(named_columns("tau", tau, log.joints))
