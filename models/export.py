"""Trained runs -> models/artifacts/*.onnx and manifest.json, each compared with PyTorch before it is written.

    python models/export.py                    every network that has a run
    python models/export.py rignet_skin        only this one; the others keep their file and their manifest entry
    python models/export.py --untrained        also networks without a run (right interface, random weights)
    A network whose further runs are named runs/<network>_2, _3 ... is exported as the mean of all of them.
    Bone and root come from the runs of rignet_skeleton_stage, displacement and attention from that of rignet_joint_stage, or, before
    there is one, of rignet_joint_pair.
    python models/evaluate.py                  afterwards: fills in the validation figures and the calibration
"""

import argparse
import hashlib
import json
import time
from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper

from rigsmith_models.artifact import FORBIDDEN_OPERATORS, INDICES, SHAPES, described, self_test, session
from rigsmith_models.committee import Committee
from rigsmith_models.folding import folded, silence_dead_channels
from rigsmith_models.networks import NETWORKS
from rigsmith_models.train.trainer import STAGES, Settings, averaged_network

HERE = Path(__file__).parent
RUNS, ARTIFACTS = HERE / "runs", HERE / "artifacts"
MANIFEST = ARTIFACTS / "manifest.json"
OPSET = 18
HALF_STORED_MIN = 256  # initialisers with at least so many numbers are stored as float16
FILE_BYTES_MAX, FOLDER_BYTES_MAX = 16 << 20, 20 << 20
PARITY_TOLERANCE = 1e-4  # of the float32 graph against PyTorch
MASKED = -1e3  # logits below it stand for an empty slot

# Until evaluate.py --calibrate has run: the measured defaults of the design.
UNTUNED_CALIBRATION = {
    "bandwidth": 0.05, "mean_shift_steps": 10, "mean_shift_step_length": 0.9, "attention_min": 0.001,
    "attention_power": 1.0, "mode_density_min": 0.01, "suppression_displacement": 0.5, "middle_max": 0.02,
}

LINKS_PER_VERTEX = 8
ROOT_MEMBERS = 2  # the third run of rignet_skeleton_stage connects well and finds poor roots (TRAINING.md, the fifth round)


def random_inputs(names, seed: int, sizes: dict[str, int]) -> dict[str, np.ndarray]:
    """Inputs of any size on a plausible shape (points of an ellipsoid), for the export itself and the parity check."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(sizes["V"], 3))
    positions = direction / np.linalg.norm(direction, axis=1, keepdims=True) * [0.2, 0.5, 0.15] + [0, 0.5, 0]
    nearest = np.linalg.norm(positions[:, None] - positions, axis=2).argsort(1)
    feed = {}
    for name in names:
        shape = [sizes.get(d, d) for d in SHAPES[name]]
        if name == "positions":
            feed[name] = positions.astype(np.float32)
        elif INDICES.get(name) == "V":
            feed[name] = np.ascontiguousarray(nearest[:, : shape[1]])
        elif name == "pairs":
            feed[name] = np.stack(np.triu_indices(sizes["J"], 1), axis=1)
        elif name in INDICES:
            feed[name] = rng.integers(0, {**sizes, "L": sizes["V"] * LINKS_PER_VERTEX}[INDICES[name]], shape)
        elif name in ("bone_mask", "link_mask"):
            feed[name] = (np.arange(shape[1]) < rng.integers(1, shape[1] + 1, (shape[0], 1))).astype(np.float32)
        elif name == "medial_offsets":
            feed[name] = rng.normal(0, 0.05, shape).astype(np.float32)
        else:
            feed[name] = rng.random(shape, np.float32)
    return feed


class OneCharacter(torch.nn.Module):
    """The network without its batch argument, which the tracer would take for an input."""

    def __init__(self, network: torch.nn.Module):
        super().__init__()
        self.network = network

    def forward(self, *inputs):
        return self.network(*inputs)


def to_onnx(network: torch.nn.Module, path: Path) -> None:
    """Writes the float32 graph with every size dynamic."""
    names, output = list(network.inputs), network.output
    example = random_inputs(names, 0, {"V": 48, "K1": 5, "K2": 9, "K3": 4, "J": 7, "P": 21})
    symbols = {n: {axis: d for axis, d in enumerate(SHAPES[n]) if isinstance(d, str)} for n in [*names, output]}
    torch.onnx.export(
        OneCharacter(folded(network)), tuple(torch.from_numpy(example[n]) for n in names), str(path), input_names=names,
        output_names=[output], opset_version=OPSET, dynamic_axes=symbols, dynamo=False,
    )


def store_as_half(model: onnx.ModelProto) -> None:
    """Large float32 initialisers become float16 plus a Cast, which ONNX Runtime folds at load: compute stays float32."""
    casts = []
    for tensor in list(model.graph.initializer):
        values = numpy_helper.to_array(tensor)
        if tensor.data_type != TensorProto.FLOAT or values.size < HALF_STORED_MIN:
            continue
        half = values.astype(np.float16)
        if not np.isfinite(half).all():
            raise ValueError(f"{tensor.name} does not fit float16")
        model.graph.initializer.remove(tensor)
        model.graph.initializer.append(numpy_helper.from_array(half, tensor.name + "_half"))
        casts.append(helper.make_node("Cast", [tensor.name + "_half"], [tensor.name], to=TensorProto.FLOAT))
    for cast in reversed(casts):
        model.graph.node.insert(0, cast)


def parity(network, path: Path) -> float:
    """Largest difference between the graph and PyTorch over sizes that the export did not see, over the outputs' usual size."""
    run = session(path)
    worst = 0.0
    for seed, sizes in enumerate(({"V": 200, "K1": 9, "K2": 11, "K3": 5, "J": 20, "P": 190}, {"V": 33, "K1": 3, "K2": 4, "K3": 1, "J": 2, "P": 1})):
        feed = random_inputs(network.inputs, seed + 1, sizes)
        with torch.no_grad():
            expected = network(*(torch.from_numpy(feed[n]) for n in network.inputs)).numpy()
        usual = max(1.0, float(np.median(np.abs(expected[expected > MASKED]))))
        worst = max(worst, float(np.abs(run.run(None, feed)[0] - expected).max()) / usual)
    return worst


def training_record(name: str, run: Path, record: dict) -> dict:
    settings, data = record["settings"], run.parent / "data.json"
    return {
        "run": f"{name}-seed{settings.seed}-step{record['step']}", "steps": record["step"], "planned_steps": settings.steps,
        "passes": record["step"] * settings.characters_per_step, "cpu_minutes": round(record["seconds"] / 60, 1),
        "learning_rate": settings.learning_rate, "data": json.loads(data.read_text()) if data.exists() else None,
    }


def run_of(name: str) -> tuple[str, str | None]:
    """-> the run that trains a network, and the network's name within it where it is part of a stage."""
    for stage, module in STAGES.items():
        part = {whole: part for part, whole in module.parts.items()}.get(name)
        if part and (stage != "rignet_joint_stage" or (RUNS / stage / "checkpoint.pt").exists()):
            return stage, part
    return name, None


def trained(name: str) -> tuple[torch.nn.Module, Settings, dict | None]:
    """The network with the weights to ship, its settings and its training record (None: random weights)."""
    source, part = run_of(name)
    runs = [RUNS / source / "checkpoint.pt", *sorted(RUNS.glob(f"{source}_[0-9]/checkpoint.pt"))]
    if part == "root":
        runs = runs[:ROOT_MEMBERS]
    if not runs[0].exists():
        settings = Settings(network=source)
        torch.manual_seed(settings.seed)
        return NETWORKS[name](settings.width, settings.normalisation).eval(), settings, None
    members, records = zip(*(averaged_network(run) for run in runs))
    if part:
        members = [getattr(member, part) for member in members]
    network = members[0] if len(members) == 1 else Committee(list(members)).eval()
    training, *others = [training_record(source, run, record) for run, record in zip(runs, records)]
    if others:
        training["members"] = others
    if source == "rignet_joint_stage":
        pair = RUNS / "rignet_joint_pair" / "checkpoint.pt"
        training["after"] = training_record("rignet_joint_pair", pair, averaged_network(pair)[1])
    return network, records[0]["settings"], training


def export_one(name: str, untrained: bool) -> dict | None:
    """Writes the file and returns its manifest entry; None where there is no run and random weights are not asked for."""
    network, settings, training = trained(name)
    if training is None and not untrained:
        return None
    network = silence_dead_channels(network)
    path = ARTIFACTS / f"{name}.onnx"
    temporary = path.with_suffix(".tmp")
    to_onnx(network, temporary)
    model = onnx.load(temporary)
    full_precision_error = parity(network, temporary)
    if not full_precision_error < PARITY_TOLERANCE:
        raise SystemExit(f"{name}: the graph differs from PyTorch by {full_precision_error:.2e}")
    forbidden = {node.op_type for node in model.graph.node} & FORBIDDEN_OPERATORS
    if forbidden:
        raise SystemExit(f"{name}: the graph contains {forbidden}")
    store_as_half(model)
    model.producer_name, model.producer_version = "rigsmith", ""
    onnx.checker.check_model(model)
    onnx.save(model, temporary)
    half_error = parity(network, temporary)
    content = temporary.read_bytes()
    if len(content) > FILE_BYTES_MAX:
        raise SystemExit(f"{name}: {len(content)} bytes, more than {FILE_BYTES_MAX}")
    temporary.replace(path)
    print(f"{name}: {len(content) / 2**20:.2f} MiB, against PyTorch {full_precision_error:.1e}, stored as float16 {half_error:.1e}")
    return {
        "file": path.name, "sha256": hashlib.sha256(content).hexdigest(), "bytes": len(content), "opset": OPSET,
        "inputs": described(network.inputs), "outputs": described([network.output]), "width": settings.width,
        "normalisation": settings.normalisation, "parameters": sum(p.numel() for p in network.parameters()),
        "parity": {"float32_graph": float(f"{full_precision_error:.1e}"), "shipped_file": float(f"{half_error:.1e}")},
        "training": training, "validation": None, "self_test": self_test(path, network.inputs, network.output),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("networks", nargs="*", choices=[*NETWORKS, []])
    parser.add_argument("--untrained", action="store_true")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    ARTIFACTS.mkdir(exist_ok=True)
    manifest = json.loads(MANIFEST.read_text()) if MANIFEST.exists() else {"networks": {}}
    manifest["format"] = 1
    manifest["self_test_formula"] = "models/artifacts/README.md"
    manifest["exported"] = time.strftime("%Y-%m-%d")
    manifest["licence"] = json.loads((HERE / "licence.json").read_text())
    manifest.setdefault("calibration", UNTUNED_CALIBRATION)
    for name in arguments.networks or NETWORKS:
        entry = export_one(name, arguments.untrained)
        if entry:
            manifest["networks"][name] = entry
    total = sum(p.stat().st_size for p in ARTIFACTS.glob("*.onnx"))
    if total > FOLDER_BYTES_MAX:
        raise SystemExit(f"{total} bytes of models, more than {FOLDER_BYTES_MAX}")
    MANIFEST.write_text(json.dumps(manifest, indent=1) + "\n")


if __name__ == "__main__":
    main()
