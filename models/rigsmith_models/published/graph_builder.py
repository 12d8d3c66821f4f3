"""Writes the published networks of RigNet as ONNX nodes, block by block. Names of weights are those of the checkpoints.

Blocks are in the naive order (a message is normalised before the maximum): every weight enters as it is stored. Opset 18,
no scatter.
"""

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

BATCH_NORM_EPSILON = 1e-5
OPSET = 18


class GraphBuilder:
    """Adds nodes; every method takes and returns tensor names. A weight is noted in ``weights`` when first used."""

    def __init__(self):
        self.nodes, self.inputs, self.constants = [], {}, {}
        self.weights: dict[str, list[int]] = {}  # name -> shape

    def add(self, operator: str, *inputs: str, outputs: int = 1, **attributes):
        names = [f"{operator.lower()}_{len(self.nodes)}_{k}" for k in range(outputs)]
        self.nodes.append(helper.make_node(operator, list(inputs), names, **attributes))
        return names[0] if outputs == 1 else names

    def input(self, name: str, shape: list, kind=TensorProto.FLOAT) -> str:
        self.inputs[name] = helper.make_tensor_value_info(name, kind, shape)
        return name

    def weight(self, name: str, shape: list[int]) -> str:
        self.weights[name] = shape
        return name

    def integers(self, values: list[int]) -> str:
        name = "integers_" + "_".join(str(v).replace("-", "m") for v in values)
        self.constants[name] = numpy_helper.from_array(np.array(values, np.int64), name)
        return name

    def number(self, value: float) -> str:
        name = f"number_{value}".replace("-", "m")
        self.constants[name] = numpy_helper.from_array(np.array(value, np.float32), name)
        return name

    def split(self, x: str, sizes: list[int], axis: int) -> list[str]:
        return self.add("Split", x, self.integers(sizes), outputs=len(sizes), axis=axis)

    def linear(self, x: str, name: str, channels_in: int, channels_out: int) -> str:
        weight = self.weight(f"{name}.weight", [channels_out, channels_in])
        return self.add("Gemm", x, weight, self.weight(f"{name}.bias", [channels_out]), transB=1)

    def batch_norm(self, x: str, name: str, channels: int) -> str:
        parts = (self.weight(f"{name}.{p}", [channels]) for p in ("weight", "bias", "running_mean", "running_var"))
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
        weight = self.weight(f"{name}.0.0.weight", [channels_out, 2 * channels_in])
        own, offset = self.split(weight, [channels_in, channels_in], axis=1)
        own = self.add("Gemm", x, self.add("Sub", own, offset), self.weight(f"{name}.0.0.bias", [channels_out]), transB=1)
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
        parts = self.split(self.weight(f"{name}.weight", [out, code_size + local_size]), sizes, axis=1)
        of_code, of_local = parts if code_first else reversed(parts)
        constant = self.add("Gemm", code, of_code, self.weight(f"{name}.bias", [out]), transB=1)
        return self.add("Add", self.add("Gemm", local, of_local, transB=1), constant)

    def model(self, result: str, output: str, shape: list, values: dict[str, np.ndarray] | None = None) -> onnx.ModelProto:
        """The graph with ``result`` as its output: weights from ``values``, or as further graph inputs."""
        self.nodes.append(helper.make_node("Identity", [result], [output]))
        inputs, constants = list(self.inputs.values()), list(self.constants.values())
        if values is None:
            inputs += [helper.make_tensor_value_info(name, TensorProto.FLOAT, size) for name, size in self.weights.items()]
        else:
            constants += [numpy_helper.from_array(np.asarray(values[name], np.float32), name) for name in self.weights]
        outputs = [helper.make_tensor_value_info(output, TensorProto.FLOAT, shape)]
        graph = helper.make_graph(self.nodes, output, inputs, outputs, constants)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="rigsmith")
        model.ir_version = 10
        onnx.checker.check_model(model, full_check=True)
        return model
