"""Published RigNet checkpoints -> a models folder that ``rigsmith --models FOLDER`` opens.

    python models/import_rignet.py FOLDER --joint FILE --bone FILE --root FILE --skin FILE --accept-licence

For people who hold those files. Rigsmith ships none of them and grants nothing on them: --accept-licence says that you
may use them as you do. Each of the four is optional; a network that is not imported keeps our own file, as does
HeterSkinNet. FILE is a ``torch.save`` file or an ``.npz`` of the same names (docs/models.md, "Networks of others").
"""

import argparse
import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import onnx

from rigsmith_models.artifact import FORBIDDEN_OPERATORS, SELF_TEST_TOLERANCE, described, self_test
from rigsmith_models.published import checkpoint
from rigsmith_models.published.checkpoint import CheckpointError
from rigsmith_models.published.graph_builder import OPSET
from rigsmith_models.published.networks import CHECKPOINTS, NETWORKS

ARTIFACTS = Path(__file__).parent / "artifacts"
MANIFEST, NOTICES = "manifest.json", "NOTICES.md"
LICENCE = "LicenseRef-RigNet-checkpoint"
BANDWIDTH = "bandwidth"  # of the joint checkpoint: the mean shift's, learned
UNUSED_SUFFIX = ".num_batches_tracked"  # a counter of training
NAMES_SHOWN = 3


def named(names: list[str]) -> str:
    more = f" and {len(names) - NAMES_SHOWN} more" if len(names) > NAMES_SHOWN else ""
    return ", ".join(names[:NAMES_SHOWN]) + more


def checked(path: Path, kind: str, tensors: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The weights of ``kind``, all there and of the right shape, or a :class:`CheckpointError` that lists what is wrong."""
    wanted = {name: shape for network in NETWORKS.values() if network.checkpoint == kind for name, shape in network.weights().items()}
    known = {n for n, values in tensors.items() if n.endswith(UNUSED_SUFFIX) or (kind == "joint" and n == BANDWIDTH and values.size == 1)}
    missing, further = [n for n in wanted if n not in tensors], [n for n in tensors if n not in wanted and n not in known]
    if missing or further:
        raise CheckpointError(
            f"{path}: not a {kind} checkpoint of RigNet: {len(missing)} of {len(wanted)} tensors are missing"
            + (f" ({named(missing)})" if missing else "") + f", {len(further)} are unknown" + (f" ({named(further)})" if further else "")
            + f"; is it one of {', '.join(k for k in CHECKPOINTS if k != kind)}?"
        )
    misshapen = [f"{n} is {list(tensors[n].shape)}, not {s}" for n, s in wanted.items() if list(tensors[n].shape) != s]
    if misshapen:
        raise CheckpointError(
            f"{path}: {len(misshapen)} tensors have another shape: {named(misshapen)}; only RigNet's published sizes are read"
        )
    broken = [n for n in wanted if not np.isfinite(tensors[n]).all()]
    if broken:
        raise CheckpointError(f"{path}: {len(broken)} tensors hold values that are no numbers: {named(broken)}")
    return {name: tensors[name].astype(np.float32) for name in wanted}


def import_network(name: str, source: Path, weights: dict[str, np.ndarray], folder: Path) -> dict:
    """Writes ``name``.onnx, weights in float32 as they are, and returns its manifest entry."""
    network = NETWORKS[name]
    model = network.model(weights)
    forbidden = {node.op_type for node in model.graph.node} & FORBIDDEN_OPERATORS
    if forbidden:
        raise RuntimeError(f"{name}: the graph contains {forbidden}")
    path = folder / f"{name}.onnx"
    onnx.save(model, path)
    content = path.read_bytes()
    known = self_test(path, network.inputs(), network.output)
    # Weights of others need not give outputs near 1, which is what the usual tolerance is for.
    known["tolerance"] = SELF_TEST_TOLERANCE * max(1.0, known["std"])
    return {
        "file": path.name, "sha256": hashlib.sha256(content).hexdigest(), "bytes": len(content), "opset": OPSET,
        "inputs": described(network.inputs()), "outputs": described([network.output]), "width": 1.0, "normalisation": "batch",
        "parameters": sum(weights[n].size for n in network.weights()), "training": None, "validation": None,
        "imported": {"file": source.name, "sha256": hashlib.sha256(source.read_bytes()).hexdigest()}, "licence": LICENCE,
        "self_test": known,
    }


def licence_of(ours: dict, imported: list[str], kept: list[str]) -> dict:
    """Whose the weights in the folder are; the program names ``weights`` with every rig. HeterSkinNet at least is ours."""
    return {
        "weights": f"{LICENCE} AND ({ours['weights']})",
        "note": f"{', '.join(imported)}: converted from checkpoints that whoever made this folder holds. These weights are "
        "theirs to use under the terms that they were published with, not Rigsmith's; Rigsmith grants nothing on them, and the "
        f"folder may be passed on only as those terms allow. {', '.join(kept)}: Rigsmith's own. {ours['note']}",
        "attributions": ["RigNet checkpoints: Xu, Zhou, Kalogerakis, Landreth and Singh 2020", *ours["attributions"]],
        "no_notice_needed": ours["no_notice_needed"],
    }


def import_all(sources: dict[str, Path], folder: Path, base: Path = ARTIFACTS) -> dict:
    """Reads and checks every checkpoint, then writes the folder; returns its manifest."""
    tensors = {kind: checkpoint.read(path) for kind, path in sources.items()}
    weights = {kind: checked(sources[kind], kind, tensors[kind]) for kind in sources}
    folder.mkdir(parents=True, exist_ok=True)
    if any(folder.iterdir()):
        raise CheckpointError(f"{folder} is not empty: name a new folder")
    manifest = json.loads((base / MANIFEST).read_text())
    entries = manifest["networks"]
    imported = [name for name, network in NETWORKS.items() if network.checkpoint in sources]
    kept = [name for name in entries if name not in imported]
    for name in imported:
        kind = NETWORKS[name].checkpoint
        entries[name] = import_network(name, sources[kind], weights[kind], folder)
    for name in kept:
        shutil.copyfile(base / entries[name]["file"], folder / entries[name]["file"])
    shutil.copyfile(base / NOTICES, folder / NOTICES)
    if BANDWIDTH in tensors.get("joint", {}):
        entries["rignet_displacement"][BANDWIDTH] = round(float(tensors["joint"][BANDWIDTH].item()), 6)
    manifest["licence"] = licence_of(manifest["licence"], imported, kept)
    (folder / MANIFEST).write_text(json.dumps(manifest, indent=1) + "\n")
    return manifest


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="to be made: the new models folder")
    for kind in CHECKPOINTS:
        parser.add_argument(f"--{kind}", type=Path, metavar="FILE")
    parser.add_argument("--accept-licence", action="store_true", help="you hold the checkpoints and accept the terms that they came with")
    arguments = parser.parse_args()
    sources = {kind: path for kind in CHECKPOINTS if (path := getattr(arguments, kind))}
    if not sources:
        parser.error("name at least one checkpoint: " + ", ".join(f"--{kind}" for kind in CHECKPOINTS))
    if not arguments.accept_licence:
        parser.error("the checkpoints are not ours: pass --accept-licence if you hold them and accept the terms that they came with")
    try:
        manifest = import_all(sources, arguments.folder)
    except CheckpointError as error:
        raise SystemExit(f"import_rignet: {error}") from error
    for name, entry in manifest["networks"].items():
        print(f"{name}: " + (f"from {entry['imported']['file']}" if "imported" in entry else "Rigsmith's own"))
    bandwidth = manifest["networks"]["rignet_displacement"].get(BANDWIDTH)
    print(f"rigsmith rig --models {arguments.folder} --skin-method {'rignet' if 'skin' in sources else 'auto'}"
          + (f" --bandwidth {bandwidth:.4f}" if bandwidth else "") + " INPUT -o OUTPUT")


if __name__ == "__main__":
    main()
