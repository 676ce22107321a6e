"""The learned velocity observer and its checkpoint on disk.

An Observer is data: weights, inputs and their scales, robot and IMU mounting, and the logs it was
trained on. `surefoot.models.observer.predict` runs it and `surefoot.models.observer.training`
creates it. Its file has the safetensors format: arrays, and all else as JSON in the metadata.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zipfile import is_zipfile

import msgspec
import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from surefoot.models.observer.inference import COMPILED, LOSS_OUTPUTS, Head, cholesky_factor
from surefoot.models.observer.novelty import Novelty, TrainingStates
from surefoot.models.observer.odometry import (
    Kinematics,
    LegGeometry,
    Mounted,
    check_leg_geometry,
    complete_weights,
    contact_points,
)
from surefoot.models.observer.settings import INSTALL_TORCH
from surefoot.models.registry import ARCHITECTURES, LOSSES
from surefoot.sim.common.errors import SurefootError, check_known
from surefoot.sim.common.files import whole_file
from surefoot.sim.common.limits import admitted, parse_json
from surefoot.sim.common.quaternion import check_rotation
from surefoot.sim.log import Log

if TYPE_CHECKING:
    from surefoot.models.observer.network import Network

OBSERVER_FORMAT = "surefoot observer"
METADATA = "surefoot"
"""Key of the JSON in the metadata."""
OBSERVER_SCHEMA, TORCH_SCHEMA = 3, 2
"""Versions of the safetensors format, and of the files of torch that surefoot 0.1.0 wrote."""
WIDEST = 4096
"""Widest layer that a checkpoint may request memory for."""
SIGNALS = ("q", "dq", "tau", "gyro", "accel", "contact")
"""What a robot measures, of which inputs are computed."""
INPUTS = (*SIGNALS, "feet")
"""Groups of inputs. `feet` is computed from q, dq and, where it is among the inputs, gyro; without,
velocities are those relative to the base.
"""


Running = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray | None, np.ndarray]]
"""Function of a robot's next samples, 10 ms apart, to v_I (M, 3) [m/s], covariances (M, 3, 3), None
of an `mse` observer, and the distance (M,) of the walk so far from the training walks, NaN where it
is not known (`surefoot.models.observer.novelty`). A sample are the `signals` (S,), unscaled, after
the anti-alias filter of `surefoot.models.observer.samples`; the state is kept between calls.
"""


class ObserverError(SurefootError):
    """An observer that cannot be read, or that does not match the log or robot."""


class TrainingLog(msgspec.Struct, frozen=True, omit_defaults=True):
    """A log an observer was trained on: its name, the digest of its samples, and plausibility
    warnings; without any, plain values have the same digest as before there were warnings.
    """

    name: str
    sha256: str
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Observer:
    """A trained network from joint signals at 100 Hz to v_I, the IMU's velocity in its own frame.

    A sample is scaled as (x - input_mean) / input_scale, an output as output_mean + output_scale *
    y in m/s.

    Attributes:
        model: name of the architecture.
        width: of its layers.
        weights: of the whole network, in float32, by the names of torch's state dict.
        inputs: joint groups, concatenated in the order of `joints`.
        joints: names.
        input_mean: of the inputs.
        input_scale: of the inputs.
        output_mean: (3,) [m/s].
        output_scale: (3,) [m/s].
        robot: name.
        p_BI: position (3,) of the IMU whose velocity was learnt [m].
        R_BI: its attitude (3, 3).
        loss: "mse" or "gml".
        logs: of the training.
        seed: of the training.
        rate: of the inputs [Hz].
        rmse: on the validation rows of the training logs (3,) [m/s].
        errors: at rows with a measured reference of these logs (M, 3) [m/s], evenly spaced, for
            comparison with errors elsewhere.
        causal_dq: whether the joint velocities were derived from q.
        legs: geometry of the robot from which `feet` is computed; empty without `feet`.
        training_states: distribution of the network's features in the training walks; empty for too
            few walks, and after tuning.
    """

    model: str
    width: int
    weights: dict[str, np.ndarray]
    inputs: tuple[str, ...]
    joints: tuple[str, ...]
    input_mean: np.ndarray
    input_scale: np.ndarray
    output_mean: np.ndarray
    output_scale: np.ndarray
    robot: str
    p_BI: np.ndarray
    R_BI: np.ndarray
    loss: str
    logs: tuple[TrainingLog, ...]
    seed: int
    rate: float
    rmse: np.ndarray
    errors: np.ndarray
    causal_dq: bool = False
    legs: LegGeometry = field(default_factory=dict)
    training_states: TrainingStates = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The robot's name, so that an Observer satisfies the protocol `Mounted`."""
        return self.robot

    @cached_property
    def hash(self) -> str:
        """SHA-256 of everything above, by which bounds identify their observer."""
        digest, values = hashlib.sha256(), _flat(self)
        for name in sorted(values):
            value = about = values[name]
            if isinstance(value, np.ndarray):
                # The names of types are torch's, as bounds of 0.1.0 know their observers by it.
                about = {"shape": list(value.shape), "dtype": f"torch.{value.dtype}"}
            digest.update(json.dumps([*name, about]).encode())
            if isinstance(value, np.ndarray):
                digest.update(value.tobytes())
        return digest.hexdigest()

    @cached_property
    def network(self) -> Network:
        """The network with these weights, in torch. Raises RuntimeError for those of another."""
        import torch

        from surefoot.models.observer.network import Network

        inputs, outputs = len(self.input_mean), LOSS_OUTPUTS[self.loss]
        network = Network(self.model, inputs, outputs, self.width, self._leg_count)
        weights = complete_weights(self.weights) if self._leg_count else self.weights
        network.load_state_dict({name: torch.from_numpy(w) for name, w in weights.items()})
        return network.eval()

    def running(self, whole: bool = False) -> Running:
        """The observer from a log's beginning on; a `gru` and an `mlp` step in compiled code.

        Raises ObserverError for a model that is not causal, unless the one call has the `whole`
        log; LookupError, ValueError or RuntimeError for weights of another network.
        """
        if self.model in COMPILED:
            features, body = self.width, COMPILED[self.model]
            body = body(self.weights, len(self.input_mean), features)
        elif whole or ARCHITECTURES[self.model].causal:
            from surefoot.models.observer.network import torch_features

            features, body = self.network.body.features, torch_features(self.network, whole)
        else:
            raise ObserverError(
                f"the observer is a {self.model}, which reads a log from both ends: it serves "
                "whole logs, not a loop; train one with model gru"
            )
        head = Head(self.weights, features, LOSS_OUTPUTS[self.loss], self._leg_count)
        novelty = Novelty(self.training_states, features)
        kinematics = Kinematics.of(self.legs, self) if self.legs else None

        def run(x: np.ndarray) -> tuple[np.ndarray, np.ndarray | None, np.ndarray]:
            inputs = observer_inputs(self.inputs, kinematics, x) - self.input_mean
            scaled = (inputs / self.input_scale).astype(np.float32, order="C")
            seen = body(scaled)
            outputs, unlike = head(scaled, seen), novelty(seen)
            v_I = self.output_mean + self.output_scale * outputs[:, :3].astype(float)
            if self.loss != "gml":
                return v_I, None, unlike
            L = self.output_scale[:, None] * cholesky_factor(outputs).astype(float)
            return v_I, L @ L.swapaxes(-1, -2), unlike

        return run

    @property
    def _leg_count(self) -> int:
        return len(self.legs["radius"]) if self.legs else 0

    def save(self, path: str | Path, force: bool = False) -> None:
        """Write the checkpoint, whole or not at all. Raises SurefootError where `path` exists."""
        about = {"format": OBSERVER_FORMAT, "schema": OBSERVER_SCHEMA, "hash": self.hash}
        arrays = {}
        for (name, key), value in _flat(self).items():
            if isinstance(value, np.ndarray):
                arrays[name if key == name else f"{name}.{key}"] = value
            else:
                about[name] = value
        with whole_file(path, force) as temporary:
            temporary.write_bytes(save(arrays, {METADATA: json.dumps(about)}))

    @classmethod
    def load(cls, path: str | Path) -> Observer:
        """Read the observer at `path`. Raises ObserverError, one line, where it is none or damaged,
        or where its architecture runs in torch, which is not installed.
        """
        try:
            path = admitted(path, "piece")
        except SurefootError as error:
            raise ObserverError(str(error)) from None
        if is_zipfile(path):
            raise ObserverError(
                f"{path}: a file of PyTorch; if it is an observer of an earlier surefoot, convert "
                f"it: surefoot export {path} -o NEW.safetensors"
            )
        try:
            with safe_open(path, "numpy") as file:
                about = parse_json((file.metadata() or {})[METADATA])
                values = about | {"weights": {}, "legs": {}, "training_states": {}}
                for name in file.keys():  # noqa: SIM118, it is no mapping
                    group, dot, key = name.partition(".")
                    among, key = (values[group], key) if dot else (values, name)
                    among[key] = np.array(file.get_tensor(name))
        except (SafetensorError, OSError, LookupError, TypeError, ValueError) as error:
            raise ObserverError(f"{path}: not a surefoot observer, or a damaged one") from error
        return _checked_observer(values, OBSERVER_SCHEMA, path)


def observer_of_torch(path: str | Path) -> Observer:
    """Read an observer that surefoot stored as a file of torch, up to 0.1.0, to convert it.

    Raises SurefootError, one line, where it is no observer, or damaged.
    """
    import torch

    def in_numpy(value: Any) -> Any:
        if isinstance(value, dict):
            return {name: in_numpy(one) for name, one in value.items()}
        return value.numpy() if isinstance(value, torch.Tensor) else value

    path = admitted(path, "piece")
    try:
        values: Any = torch.load(path, map_location="cpu", weights_only=True)
        # Those from before leg odometry have no legs.
        content = {"legs": {}, "training_states": {}} | {
            name: in_numpy(value) for name, value in values.items()
        }
    except Exception as error:
        # torch raises many types here, depending on the file's contents.
        raise ObserverError(f"{path}: not a surefoot observer, or a damaged one") from error
    return _checked_observer(content, TORCH_SCHEMA, path)


def _checked_observer(values: dict[str, Any], schema: int, path: Path) -> Observer:
    """The observer of a file's contents. Raises ObserverError, one line, where it is not whole, or
    its architecture runs in torch, which is not installed.

    Args:
        values: of its attributes, as plain values, arrays and dicts of arrays; format, schema and
            hash.
        schema: that the file must have.
        path: of the file.
    """
    if values.get("format") != OBSERVER_FORMAT:
        raise ObserverError(f"{path}: not a surefoot observer")
    if values.get("schema") != schema:
        raise ObserverError(
            f"{path}: of schema {values.get('schema')}, this surefoot reads {schema}; train it "
            "again"
        )
    try:
        observer = _from_plain(values)
        observer.running(whole=True)
    except (LookupError, TypeError, ValueError, RuntimeError, AttributeError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ObserverError(f"{path}: not a whole surefoot observer ({reason})") from error
    except ModuleNotFoundError as error:
        if error.name != "torch":
            raise
        raise ObserverError(
            f"{path}: its architecture runs in PyTorch, unlike {' and '.join(COMPILED)}; "
            f"{INSTALL_TORCH}"
        ) from None
    if observer.hash != values.get("hash"):
        raise ObserverError(f"{path}: damaged, its contents do not match their digest")
    return observer


def check_robot(
    observer: Observer, robot: Mounted, joints: tuple[str, ...], prefix: str = ""
) -> None:
    """Raise ObserverError, with a prefix, where a log's robot or joints are not the observer's."""
    if robot.name != observer.robot:
        raise ObserverError(
            f"{prefix}the observer was trained on {observer.robot}, the log is of {robot.name}"
        )
    if joints != observer.joints:
        raise ObserverError(
            f"{prefix}the observer reads the joints {', '.join(observer.joints)}, the log has "
            f"{', '.join(joints)}"
        )


def check_inputs(inputs: tuple[str, ...] | str) -> tuple[str, ...]:
    """Groups in the order of INPUTS, from "q,dq,tau" too. Raises ObserverError for an unknown one,
    one that is given twice, or none.
    """
    names = inputs.replace(" ", "").split(",") if isinstance(inputs, str) else inputs
    if not names:
        raise ObserverError("inputs: none are given")
    for name in names:
        check_known("inputs", name, INPUTS, ObserverError)
        if names.count(name) > 1:
            raise ObserverError(f"inputs: {name} is given twice")
    return tuple(name for name in INPUTS if name in names)


def signals(inputs: tuple[str, ...]) -> tuple[str, ...]:
    """Signals of a log from which these inputs are computed."""
    wanted = {"q", "dq", *inputs} if "feet" in inputs else set(inputs)
    return tuple(name for name in SIGNALS if name in wanted)


def _columns(names: Iterable[str], joints: int, legs: int) -> list[int]:
    """Number of columns of each group."""
    # Each leg contributes position and velocity of its contact point.
    known = {"gyro": 3, "accel": 3, "contact": legs, "feet": 6 * legs}
    return [known.get(name, joints) for name in names]


def observer_inputs(inputs: tuple[str, ...], known: Kinematics | None, x: np.ndarray) -> np.ndarray:
    """Unscaled inputs (M, C) of a network from `signals(inputs)` (M, S) at the same rows.

    `known` is needed for `feet` only.
    """
    if known is None:
        return x
    names = signals(inputs)
    legs = len(known.radius)
    fixed, with_one = (sum(_columns(names, count, legs)) for count in (0, 1))
    joints = (x.shape[1] - fixed) // (with_one - fixed)
    ends = np.cumsum(_columns(names, joints, legs))
    measured = dict(zip(names, np.split(x, ends[:-1], axis=1), strict=True))
    omega = measured.get("gyro", np.zeros((len(x), 3)))
    feet = contact_points(known, measured["q"], measured["dq"], omega)
    return np.concatenate([*(measured[name] for name in names if name in inputs), feet], axis=1)


def check_network(model: str, loss: str) -> None:
    """Raise ObserverError for a loss or an architecture that does not exist."""
    check_known("model", model, ARCHITECTURES, ObserverError)
    check_known("loss", loss, LOSSES, ObserverError)


def log_digest(log: Log) -> str:
    """SHA-256 of a log's time and joint positions, independent of its name."""
    digest = hashlib.sha256(",".join(log.joints).encode())
    for values in (log.t, log.q):
        digest.update(np.ascontiguousarray(values, dtype="<f8").tobytes())
    return digest.hexdigest()


def _flat(observer: Observer) -> dict[tuple[str, str], Any]:
    """Arrays and plain values, by attribute and key in it, or the attribute again without keys."""
    values: dict[tuple[str, str], Any] = {}
    for name in (f.name for f in fields(observer)):
        value = getattr(observer, name)
        if isinstance(value, dict):
            values |= {(name, key): np.ascontiguousarray(one) for key, one in value.items()}
        elif isinstance(value, np.ndarray):
            values[name, name] = value.astype(float, order="C")
        else:
            values[name, name] = msgspec.to_builtins(value)
    return values


def _from_plain(values: dict[str, Any]) -> Observer:
    observer = msgspec.convert({f.name: values[f.name] for f in fields(Observer)}, Observer)
    check_inputs(observer.inputs)
    check_network(observer.model, observer.loss)
    if not 0 < observer.width <= WIDEST:
        raise ValueError(f"width is not within 1 and {WIDEST}")
    joints, legs = len(observer.joints), len(observer.legs.get("radius", ()))
    channels = sum(_columns(observer.inputs, joints, legs))
    if "feet" in observer.inputs:
        check_leg_geometry(observer.legs, joints)
    elif observer.legs:
        raise ValueError("legs without feet among the inputs")
    shapes = {"input_mean": (channels,), "input_scale": (channels,), "R_BI": (3, 3)}
    shapes |= dict.fromkeys(("output_mean", "output_scale", "p_BI", "rmse"), (3,))
    shapes["errors"] = (len(observer.errors), 3)
    for name, shape in shapes.items():
        if np.shape(values[name]) != shape:
            raise ValueError(f"{name} is not of shape {shape}")
        if not np.all(np.isfinite(values[name])):
            raise ValueError(f"{name} is not finite")
    check_rotation(observer.R_BI)
    if min(observer.input_scale.min(), observer.output_scale.min()) <= 0:
        raise ValueError("a scale is not positive")
    for name, weight in observer.weights.items():
        if weight.dtype != np.float32 or not np.isfinite(weight).all():
            raise ValueError(f"weights: {name} is not finite and float32")
    for name, value in observer.training_states.items():
        if not np.isfinite(value).all():
            raise ValueError(f"training_states: {name} is not finite")
    return observer
