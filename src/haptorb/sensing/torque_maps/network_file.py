"""Trained networks on disk: one line of JSON (device, digest, training record, shapes, hash) and the weights.

The file belongs to one device by its digest, and is refused for another one. It is written whole or not at all.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np

from haptorb.devices.motor.spherical_motor import SphericalMotor
from haptorb.errors import InputError
from haptorb.files.file_kind import FileKind
from haptorb.files.replace_file import replace_file
from haptorb.files.text_file import parse_json, read_bytes
from haptorb.numerics.arrays import Array
from haptorb.numerics.cache_folder import cache_folder
from haptorb.sensing.torque_maps.network import TrainedNetworks
from haptorb.sensing.torque_maps.perceptron import Perceptron, Scaling

__all__ = ["check_networks", "networks_path", "parse_networks", "read_networks", "write_networks"]

_KIND = "haptorb networks 1"
_MOST = 64 * 1024 * 1024  #: bytes


def networks_path(motor: SphericalMotor) -> Path:
    """The default place of the networks of `motor`: in the user's cache folder, by digest."""
    return cache_folder() / "networks" / f"{motor.name}-{motor.digest[:16]}.network"


def check_networks(motor: SphericalMotor) -> TrainedNetworks:
    """The networks of `motor` from there; InputError saying how to train them if there are none."""
    path = networks_path(motor)
    if not path.is_file():
        raise InputError(f"no network has been trained for device '{motor.name}' yet: run `haptorb train {motor.name}`")
    return read_networks(path)


def write_networks(networks: TrainedNetworks, path: Path) -> None:
    """Write the file, or leave what was there; InputError where it cannot be written."""
    parts = [part for network in networks.networks for part in _arrays(network)]
    numbers = b"".join(np.ascontiguousarray(part, dtype="<f8").tobytes() for part in parts)
    head = {
        "kind": _KIND,
        "device": networks.device,
        "digest": networks.digest,
        "reach": networks.reach,
        "shapes": [list(part.shape) for part in parts],
        "record": dict(networks.record),
    }
    head["sha256"] = _digest(head, numbers)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with replace_file(path) as part:
            part.write_bytes(json.dumps(head, ensure_ascii=False).encode() + b"\n" + numbers)
    except OSError as cause:
        raise InputError(f"the networks cannot be written to '{path}': {cause.strerror}") from cause


def read_networks(path: Path) -> TrainedNetworks:
    """What `write_networks` wrote; InputError where the file is absent, torn, altered or something else."""
    try:
        content = read_bytes(path, _MOST, "network file", InputError, FileKind.NETWORK)
    except InputError as cause:
        raise InputError(f"{cause}; run `haptorb train`") from cause
    return parse_networks(content, f"network file '{path}'")


def parse_networks(content: bytes, where: str) -> TrainedNetworks:
    """The networks of a file's `content`; `where` it was found is what InputError names, if it is torn, altered or
    something else."""
    line, _, numbers = content.partition(b"\n")
    try:
        head: dict[str, Any] = parse_json(line)
        if head.get("kind") != _KIND:
            raise InputError(f"{where} is not one of this version; run `haptorb train`")
        digest = head.pop("sha256")
        if digest != _digest(head, numbers):
            raise InputError(f"{where} has been changed or truncated: its hash does not match; train again")
        weights = np.frombuffer(numbers, dtype="<f8").astype(np.float64)
        ends = np.cumsum([0, *(int(np.prod(shape)) for shape in head["shapes"])])
        parts = [weights[ends[i] : ends[i + 1]].reshape(shape) for i, shape in enumerate(head["shapes"])]
        if len(parts) % 6 or not np.isfinite(weights).all() or ends[-1] != len(weights):
            raise ValueError("weights that are not numbers, too many or too few")
        networks = tuple(
            Perceptron(parts[i], parts[i + 1], Scaling(parts[i + 2], parts[i + 3]), Scaling(parts[i + 4], parts[i + 5]))
            for i in range(0, len(parts), 6)
        )
        for network in networks:
            _check_sizes(network)
        if not all(isinstance(head[key], kind) for key, kind in (("device", str), ("digest", str), ("record", dict))):
            raise TypeError("device, digest and record")
        return TrainedNetworks(head["device"], head["digest"], float(head["reach"]), networks, head["record"])
    except InputError:
        raise
    except (ValueError, KeyError, TypeError, IndexError, AttributeError, OverflowError) as cause:
        raise InputError(f"{where} is not a network file of haptorb; run `haptorb train`") from cause


def _check_sizes(network: Perceptron) -> None:
    """ValueError unless weights and scalings have sizes that go together."""
    inputs, outputs = len(network.inputs.mean), len(network.outputs.mean)
    nodes = len(network.hidden)
    wanted = ((nodes, inputs + 1), (outputs, nodes + 1), (inputs,), (inputs,), (outputs,), (outputs,))
    if any(part.shape != shape for part, shape in zip(_arrays(network), wanted, strict=True)):
        raise ValueError("sizes that do not match")
    if not ((network.inputs.spread > 0).all() and (network.outputs.spread > 0).all()):
        raise ValueError("a spread that is not positive")


def _arrays(network: Perceptron) -> tuple[Array, ...]:
    inputs, outputs = network.inputs, network.outputs
    return network.hidden, network.output, inputs.mean, inputs.spread, outputs.mean, outputs.spread


def _digest(head: dict[str, Any], numbers: bytes) -> str:
    return hashlib.sha256(json.dumps(head, sort_keys=True).encode() + numbers).hexdigest()
