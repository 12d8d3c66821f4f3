"""Writes tests/golden/rignet_{displacement,attention,skin}_rule.onnx: full-width reference networks without weights.

    python models/golden.py                       write the files
    python models/golden.py --check GOLDEN_DIR    and compare with the reference's outputs in GOLDEN_DIR/*_golden.npz

Every weight is a graph input, named as in GOLDEN_DIR/weight_rule_tensors.json; a test fills them by the rule given there
(GOLDEN_DIR/README.md), runs the graph on the reference's inputs and compares with the reference's outputs. So the test
covers what a trained file cannot: that graph, neighbour tables and message direction are those of the published method.

Inputs besides the weights: ``positions`` f32 [V, 3], ``one_ring`` i64 [V, K1] and ``geodesic_ball`` i64 [V, K2] (row v: v
itself and every u with an edge u -> v, padded with v), for skin also ``bone_features`` f32 [V, 40] (the reference's, not
clamped). Outputs: ``displacement`` [V, 3], ``attention_logit`` [V, 1], ``skin_logit`` [V, 5].

The graphs (``rigsmith_models/published``) are in the naive order, so they also serve as the oracle of the folded graphs that
ship.
"""

import argparse
import json
from pathlib import Path

import numpy as np
import onnx

from rigsmith_models.published import networks
from rigsmith_models.published.graph_builder import GraphBuilder

HERE = Path(__file__).parent
OUTPUT = HERE.parent / "tests" / "golden"
TOLERANCE = 0.01  # of the standard deviation of the reference output
REFERENCE_OUTPUTS = {"displacement": "net_joint_displacement", "attention": "net_attention_logit", "skin": "net_skin_logit"}


def joint_network(prefix: str, output: str, channels: int) -> onnx.ModelProto:
    """``prefix`` is ``jointnet`` or ``masknet``."""
    builder = GraphBuilder()
    networks.shape_inputs(builder)
    result = networks.joint_head(builder, prefix, channels)
    return builder.model(builder.add("Tanh", result) if output == "displacement" else result, output, ["V", channels])


def skin_network() -> onnx.ModelProto:
    builder = GraphBuilder()
    networks.shape_inputs(builder)
    result = networks.skin_head(builder, builder.input("bone_features", ["V", 40]))
    return builder.model(result, "skin_logit", ["V", 5])


def rule_tensor(number: int, name: str, shape: list[int]) -> np.ndarray:
    """Tensor ``number`` of a network under the weight rule: splitmix64 to u in [0, 1), then scaled by the kind of tensor."""
    count = int(np.prod(shape))
    with np.errstate(over="ignore"):
        z = np.uint64(number << 40) + np.arange(count, dtype=np.uint64) + np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        u = ((z ^ (z >> np.uint64(31))) >> np.uint64(11)).astype(np.float64) / 2.0**53
    if len(shape) == 2:
        values = (2 * u - 1) * np.sqrt(3.0 / shape[1])
    elif name.endswith(("running_var", ".weight")):
        values = 0.5 + u
    else:
        values = (2 * u - 1) * 0.1
    return values.reshape(shape).astype(np.float32)


def neighbour_table(edges: np.ndarray, vertex_count: int) -> np.ndarray:
    """edges: (E, 2) source, target -> (V, K), row v: v and the sources of its edges, padded with v."""
    rows = [[v] for v in range(vertex_count)]
    for source, target in edges:
        rows[target].append(int(source))
    width = max(len(row) for row in rows)
    return np.array([row + [row[0]] * (width - len(row)) for row in rows], np.int64)


def check(folder: Path) -> bool:
    """Runs every graph on every golden mesh and prints max |difference| / std of the reference output."""
    import onnxruntime

    tensors = json.loads((folder / "weight_rule_tensors.json").read_text())
    passed = True
    for name, reference in REFERENCE_OUTPUTS.items():
        session = onnxruntime.InferenceSession(str(OUTPUT / f"rignet_{name}_rule.onnx"), providers=["CPUExecutionProvider"])
        wanted = {i.name for i in session.get_inputs()}
        table = tensors["skin" if name == "skin" else "joint"]
        weights = {label: rule_tensor(number, label, shape) for number, label, shape, _ in table if label in wanted}
        for path in sorted(folder.glob("*_golden.npz")):
            with np.load(path) as data:
                count = len(data["vertices"])
                feed = {
                    "positions": data["vertices"].astype(np.float32),
                    "one_ring": neighbour_table(data["tpl_edges"], count),
                    "geodesic_ball": neighbour_table(data["geo_edges_sampled"], count),
                    "bone_features": data["skin_features"].astype(np.float32),
                }
                expected = data[reference]
            got = session.run(None, {**{k: v for k, v in feed.items() if k in wanted}, **weights})[0]
            error = float(np.abs(got - expected).max() / expected.std())
            passed &= error < TOLERANCE
            print(f"{name} {path.stem}: V {count}, K1 {feed['one_ring'].shape[1]}, K2 {feed['geodesic_ball'].shape[1]}, "
                  f"max error / std {error:.2e} (limit {TOLERANCE})")
    return passed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", type=Path, metavar="GOLDEN_DIR")
    arguments = parser.parse_args()
    OUTPUT.mkdir(parents=True, exist_ok=True)
    for name, model in {
        "displacement": joint_network("jointnet", "displacement", 3),
        "attention": joint_network("masknet", "attention_logit", 1),
        "skin": skin_network(),
    }.items():
        onnx.save(model, OUTPUT / f"rignet_{name}_rule.onnx")
    if arguments.check and not check(arguments.check):
        raise SystemExit("a graph differs from the reference")


if __name__ == "__main__":
    main()
