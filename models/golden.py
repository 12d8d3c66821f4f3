"""Writes tests/golden/rignet_{displacement,attention,skin}_rule.onnx: full-width reference networks without weights.

    python models/golden.py                       write the files
    python models/golden.py --check GOLDEN_DIR    and compare with the reference's outputs in GOLDEN_DIR/*_golden.npz

Every weight is a graph input, named as in GOLDEN_DIR/weight_rule_tensors.json; a test fills them by the rule given there
(GOLDEN_DIR/README.md), runs the graph on the reference's inputs and compares with the reference's outputs. So the test
covers what a trained file cannot: that graph, neighbour tables and message direction are those of the published method.

Inputs besides the weights: ``positions`` f32 [V, 3], ``one_ring`` i64 [V, K1] and ``geodesic_ball`` i64 [V, K2] (row v: v
itself and every u with an edge u -> v, padded with v), for skin also ``bone_features`` f32 [V, 40] (the reference's, not
clamped). Outputs: ``displacement`` [V, 3], ``attention_logit`` [V, 1], ``skin_logit`` [V, 5].

The graphs are in the naive order (a message is normalised before the maximum), so they also serve as the oracle of the
folded graphs that ship. Opset 18, no scatter.
"""

import argparse
import json
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

HERE = Path(__file__).parent
OUTPUT = HERE.parent / "tests" / "golden"
BATCH_NORM_EPSILON = 1e-5
TOLERANCE = 0.01  # of the standard deviation of the reference output
REFERENCE_OUTPUTS = {"displacement": "net_joint_displacement", "attention": "net_attention_logit", "skin": "net_skin_logit"}


class GraphBuilder:
    """Adds nodes; every method takes and returns tensor names. Weights become graph inputs when first used."""

    def __init__(self):
        self.nodes, self.inputs, self.constants = [], {}, {}

    def add(self, operator: str, *inputs: str, outputs: int = 1, **attributes):
        names = [f"{operator.lower()}_{len(self.nodes)}_{k}" for k in range(outputs)]
        self.nodes.append(helper.make_node(operator, list(inputs), names, **attributes))
        return names[0] if outputs == 1 else names

    def input(self, name: str, shape: list, kind=TensorProto.FLOAT) -> str:
        self.inputs[name] = helper.make_tensor_value_info(name, kind, shape)
        return name

    def integers(self, values: list[int]) -> str:
        name = "integers_" + "_".join(str(v).replace("-", "m") for v in values)
        self.constants[name] = numpy_helper.from_array(np.array(values, np.int64), name)
        return name

    def split(self, x: str, sizes: list[int], axis: int) -> list[str]:
        return self.add("Split", x, self.integers(sizes), outputs=len(sizes), axis=axis)

    def linear(self, x: str, name: str, channels_in: int, channels_out: int) -> str:
        weight = self.input(f"{name}.weight", [channels_out, channels_in])
        return self.add("Gemm", x, weight, self.input(f"{name}.bias", [channels_out]), transB=1)

    def batch_norm(self, x: str, name: str, channels: int) -> str:
        parts = (self.input(f"{name}.{p}", [channels]) for p in ("weight", "bias", "running_mean", "running_var"))
        return self.add("BatchNormalization", x, *parts, epsilon=BATCH_NORM_EPSILON)

    def dense(self, x: str, linear: str, norm: str, channels_in: int, channels_out: int) -> str:
        """Linear -> ReLU -> BatchNorm."""
        return self.batch_norm(self.add("Relu", self.linear(x, linear, channels_in, channels_out)), norm, channels_out)

    def perceptron(self, x: str, name: str, channels: list[int]) -> str:
        for k, (a, b) in enumerate(zip(channels[:-1], channels[1:])):
            x = self.dense(x, f"{name}.{k}.0", f"{name}.{k}.2", a, b)
        return x

    def edge_convolution(self, x: str, neighbours: str, name: str, channels_in: int, channels_out: int) -> str:
        """max over u of MLP(x_v, x_u - x_v), the first layer split into its part on x_v and its part on x_u."""
        weight = self.input(f"{name}.0.0.weight", [channels_out, 2 * channels_in])
        own, offset = self.split(weight, [channels_in, channels_in], axis=1)
        own = self.add("Gemm", x, self.add("Sub", own, offset), self.input(f"{name}.0.0.bias", [channels_out]), transB=1)
        other = self.add("Gather", self.add("Gemm", x, offset, transB=1), neighbours, axis=0)
        message = self.add("Relu", self.add("Add", self.add("Unsqueeze", own, self.integers([1])), other))
        flat = self.add("Reshape", message, self.integers([-1, channels_out]))
        flat = self.batch_norm(flat, f"{name}.0.2", channels_out)
        flat = self.dense(flat, f"{name}.1.0", f"{name}.1.2", channels_out, channels_out)
        rows = self.add("Concat", self.add("Shape", neighbours), self.integers([channels_out]), axis=0)
        return self.add("ReduceMax", self.add("Reshape", flat, rows), self.integers([1]), keepdims=0)

    def gm_edge_convolution(self, x: str, name: str, channels_in: int, channels_out: int) -> str:
        half = channels_out // 2
        ring = self.edge_convolution(x, "one_ring", f"{name}.edge_conv_tpl.nn", channels_in, half)
        ball = self.edge_convolution(x, "geodesic_ball", f"{name}.edge_conv_geo.nn", channels_in, half)
        return self.perceptron(self.add("Concat", ring, ball, axis=1), f"{name}.mlp", [channels_out, channels_out])

    def global_maximum(self, x: str) -> str:
        return self.add("ReduceMax", x, self.integers([0]), keepdims=1)

    def head_layer(self, local: str, code: str, name: str, code_first: bool, local_size: int, code_size: int, out: int):
        """A linear layer over [code | local] or [local | code], where the code is one row for the whole mesh."""
        sizes = [code_size, local_size] if code_first else [local_size, code_size]
        parts = self.split(self.input(f"{name}.weight", [out, code_size + local_size]), sizes, axis=1)
        of_code, of_local = parts if code_first else reversed(parts)
        constant = self.add("Gemm", code, of_code, self.input(f"{name}.bias", [out]), transB=1)
        return self.add("Add", self.add("Gemm", local, of_local, transB=1), constant)

    def model(self, result: str, output: str, channels: int) -> onnx.ModelProto:
        self.nodes.append(helper.make_node("Identity", [result], [output]))
        outputs = [helper.make_tensor_value_info(output, TensorProto.FLOAT, ["V", channels])]
        graph = helper.make_graph(self.nodes, output, list(self.inputs.values()), outputs, list(self.constants.values()))
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], producer_name="rigsmith")
        model.ir_version = 10
        onnx.checker.check_model(model, full_check=True)
        return model


def shape_inputs(builder: GraphBuilder) -> None:
    builder.input("positions", ["V", 3])
    builder.input("one_ring", ["V", "K1"], TensorProto.INT64)
    builder.input("geodesic_ball", ["V", "K2"], TensorProto.INT64)


def joint_network(prefix: str, output: str, channels: int) -> onnx.ModelProto:
    """RigNet, Section 4.1, Table 6; ``prefix`` is ``jointnet`` or ``masknet``."""
    builder = GraphBuilder()
    shape_inputs(builder)
    x1 = builder.gm_edge_convolution("positions", f"{prefix}.gcu_1", 3, 64)
    x2 = builder.gm_edge_convolution(x1, f"{prefix}.gcu_2", 64, 256)
    x3 = builder.gm_edge_convolution(x2, f"{prefix}.gcu_3", 256, 512)
    code = builder.perceptron(builder.add("Concat", x1, x2, x3, axis=1), f"{prefix}.mlp_glb", [832, 1024])
    local = builder.add("Concat", "positions", x1, x2, x3, axis=1)
    head = f"{prefix}.mlp_tramsform"
    hidden = builder.head_layer(local, builder.global_maximum(code), f"{head}.0.0.0", True, 835, 1024, 1024)
    hidden = builder.batch_norm(builder.add("Relu", hidden), f"{head}.0.0.2", 1024)
    hidden = builder.dense(hidden, f"{head}.0.1.0", f"{head}.0.1.2", 1024, 256)
    result = builder.linear(hidden, f"{head}.2", 256, channels)
    return builder.model(builder.add("Tanh", result) if output == "displacement" else result, output, channels)


def skin_network() -> onnx.ModelProto:
    """RigNet, Section 4.3, Table 6, 5 bones of 8 numbers."""
    builder = GraphBuilder()
    shape_inputs(builder)
    builder.input("bone_features", ["V", 40])
    embedded = builder.perceptron(builder.add("Concat", "positions", "bone_features", axis=1), "multi_layer_tranform1", [43, 128, 64])
    x1 = builder.gm_edge_convolution(embedded, "gcu1", 64, 512)
    code = builder.global_maximum(builder.perceptron(x1, "multi_layer_tranform2", [512, 512, 1024]))
    x3 = builder.gm_edge_convolution(builder.gm_edge_convolution(x1, "gcu2", 512, 256), "gcu3", 256, 256)
    hidden = builder.head_layer(x3, code, "cls_branch.0", False, 256, 1024, 1024)
    hidden = builder.batch_norm(builder.add("Relu", hidden), "cls_branch.2", 1024)
    hidden = builder.dense(hidden, "cls_branch.3", "cls_branch.5", 1024, 512)
    return builder.model(builder.linear(hidden, "cls_branch.6", 512, 5), "skin_logit", 5)


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
