"""Measured torques compared with commanded ones, including the declared delay."""

import numpy as np

from surefoot.models.residuals.binning import bin_mean
from surefoot.models.residuals.channel import Channel, Column, ResidualInputs
from surefoot.models.residuals.channels import per_joint, rows_of_bin
from surefoot.sim.log import Log, joint_velocity
from surefoot.sim.robot.limbs import Limbs
from surefoot.sim.sensors.streams import Sensors


class CommandedTorque(Channel):
    """Measured torque minus the commanded one, or that of the motor law."""

    name = "command"
    unit = "N m"
    needs = ("q", "tau", "tau_ff")
    on_fixed_base = True

    def columns(self, limbs: Limbs) -> tuple[Column, ...]:
        return per_joint("command", self.unit, limbs)

    def residual(self, inputs: ResidualInputs) -> np.ndarray | None:
        log, late = inputs.log, inputs.robot.extras.command_late
        law = ("q_des", "dq_des", "q", "dq") if log.meta.motor_law else ()

        def made() -> np.ndarray | None:
            asked = commanded_torque(log)
            if asked is None or not log.has("tau"):
                return None
            if late:
                then = log.t - late
                asked = np.column_stack([np.interp(then, log.t, column) for column in asked.T])
            return bin_mean(inputs.motion)(log.tau - asked)

        uses = ("tau", "tau_ff", *law)
        return log.once("torque less the command", uses, made, late, inputs.motion.first)

    def noise(self, sensors: Sensors, rate: float, evenness: float) -> float:
        return sensors.torque_noise / np.sqrt(rows_of_bin(rate))

    def is_available(self, log: Log, fixed: bool, level: bool, by_feet: bool = False) -> bool:
        return log.has("tau") and commanded_torque(log) is not None


def commanded_torque(log: Log) -> np.ndarray | None:
    """Commanded torques kp (q_des - q) + kd (dq_des - dq) + tau_ff (N, J) [N m].

    Uses the terms that the log has; None where it has none, or where its torques were derived from
    them.
    """
    if "tau" in log.meta.derived:
        return None
    total = log.tau_ff if log.has("tau_ff") else None
    if log.meta.motor_law and log.has("q_des"):
        kp, kd = (np.asarray(log.meta.motor_law[gain], dtype=float) for gain in ("kp", "kd"))
        wanted = log.dq_des if log.has("dq_des") else 0.0
        law = kp * (log.q_des - log.q) + kd * (wanted - joint_velocity(log))
        total = law if total is None else law + total
    return total
