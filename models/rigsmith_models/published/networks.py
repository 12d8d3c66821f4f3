"""The five published networks of RigNet [Xu et al. 2020] as graphs, and what the program sends them.

Layer sizes: Table 6 of the paper and the supplement. The names of weights are those of the published checkpoints, of which
there are four: ``joint`` (displacement and attention), ``bone``, ``root`` and ``skin``.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import onnx
from onnx import TensorProto

from . import joint_sets
from .graph_builder import GraphBuilder

EMPTY_SLOT_LOGIT = -1e4  # of a slot without a bone: its softmax weight is zero
BONES, BONE_CHANNELS = 5, 8


def shape_inputs(builder: GraphBuilder) -> None:
    builder.input("positions", ["V", 3])
    builder.input("one_ring", ["V", "K1"], TensorProto.INT64)
    builder.input("geodesic_ball", ["V", "K2"], TensorProto.INT64)


def joint_head(builder: GraphBuilder, prefix: str, channels: int) -> str:
    """Section 4.1; ``prefix`` is ``jointnet`` or ``masknet``. -> [V, channels]"""
    x1 = builder.gm_edge_convolution("positions", f"{prefix}.gcu_1", 3, 64)
    x2 = builder.gm_edge_convolution(x1, f"{prefix}.gcu_2", 64, 256)
    x3 = builder.gm_edge_convolution(x2, f"{prefix}.gcu_3", 256, 512)
    code = builder.perceptron(builder.add("Concat", x1, x2, x3, axis=1), f"{prefix}.mlp_glb", [832, 1024])
    local = builder.add("Concat", "positions", x1, x2, x3, axis=1)
    head = f"{prefix}.mlp_tramsform"
    hidden = builder.head_layer(local, builder.global_maximum(code), f"{head}.0.0.0", True, 835, 1024, 1024)
    hidden = builder.batch_norm(builder.add("Relu", hidden), f"{head}.0.0.2", 1024)
    hidden = builder.dense(hidden, f"{head}.0.1.0", f"{head}.0.1.2", 1024, 256)
    return builder.linear(hidden, f"{head}.2", 256, channels)


def skin_head(builder: GraphBuilder, bone_features: str) -> str:
    """Section 4.3: 5 bones of 8 numbers, [V, 40] -> [V, 5]"""
    embedded = builder.perceptron(builder.add("Concat", "positions", bone_features, axis=1), "multi_layer_tranform1", [43, 128, 64])
    x1 = builder.gm_edge_convolution(embedded, "gcu1", 64, 512)
    code = builder.global_maximum(builder.perceptron(x1, "multi_layer_tranform2", [512, 512, 1024]))
    x3 = builder.gm_edge_convolution(builder.gm_edge_convolution(x1, "gcu2", 512, 256), "gcu3", 256, 256)
    hidden = builder.head_layer(x3, code, "cls_branch.0", False, 256, 1024, 1024)
    hidden = builder.batch_norm(builder.add("Relu", hidden), "cls_branch.2", 1024)
    hidden = builder.dense(hidden, "cls_branch.3", "cls_branch.5", 1024, 512)
    return builder.linear(hidden, "cls_branch.6", 512, BONES)


def shape_code(builder: GraphBuilder, channels: list[int]) -> str:
    """-> [1, channels[-1]]"""
    x1 = builder.gm_edge_convolution("positions", "shape_encoder.gcu_1", 3, 64)
    x2 = builder.gm_edge_convolution(x1, "shape_encoder.gcu_2", 64, 128)
    x3 = builder.gm_edge_convolution(x2, "shape_encoder.gcu_3", 128, 256)
    mixed = builder.perceptron(builder.add("Concat", x1, x2, x3, axis=1), "shape_encoder.mlp_glb", channels)
    return builder.global_maximum(mixed)


def beside_every_row(builder: GraphBuilder, code: str, rows: str, channels: int) -> str:
    """[1, channels], [n, C] -> [n, channels + C]"""
    size = builder.add("Concat", joint_sets.count(builder, rows), builder.integers([channels]), axis=0)
    return builder.add("Concat", builder.add("Expand", code, size), rows, axis=1)


def displacement(builder: GraphBuilder) -> str:
    shape_inputs(builder)
    return builder.add("Tanh", joint_head(builder, "jointnet", 3))


def attention(builder: GraphBuilder) -> str:
    shape_inputs(builder)
    return builder.add("Squeeze", joint_head(builder, "masknet", 1), builder.integers([1]))


def bone(builder: GraphBuilder) -> str:
    """Section 4.2. The two ends of a pair enter in the order given, the paper's is the lower index first."""
    shape_inputs(builder)
    builder.input("joints", ["J", 3])
    builder.input("pairs", ["P", 2], TensorProto.INT64)
    builder.input("pair_features", ["P", 2])
    points, features = joint_sets.set_abstraction(
        builder, "joints", None, "joint_encoder.sa1_module_joints.conv.local_nn", 0.999, 0.4, [3, 64, 64, 128])
    points, features = joint_sets.set_abstraction(
        builder, points, features, "joint_encoder.sa2_module_joints.conv.local_nn", 0.33, 0.6, [131, 128, 128, 256])
    joint_code = joint_sets.global_abstraction(
        builder, points, features, "joint_encoder.sa3_module_joints.nn", [259, 256, 256, 512, 256, 128])
    ends = builder.add("Reshape", builder.add("Gather", "joints", "pairs", axis=0), builder.integers([-1, 6]))
    pair_code = builder.perceptron(builder.add("Concat", ends, "pair_features", axis=1), "expand_joint_feature.0", [8, 32, 64, 128, 256])
    codes = builder.add("Concat", shape_code(builder, [448, 256, 64]), joint_code, axis=1)
    hidden = builder.perceptron(beside_every_row(builder, codes, pair_code, 192), "mix_transform.0", [448, 128, 64])
    return builder.add("Squeeze", builder.linear(hidden, "mix_transform.2", 64, 1), builder.integers([1]))


def root(builder: GraphBuilder) -> str:
    """Section 4.2."""
    shape_inputs(builder)
    builder.input("joints", ["J", 3])
    side = builder.add("Abs", builder.split("joints", [1, 2], axis=1)[0])
    points_1, features_1 = joint_sets.set_abstraction(
        builder, "joints", side, "joint_encoder.sa1_joint.conv.local_nn", 0.999, 0.4, [4, 64, 64, 128])
    points_2, features_2 = joint_sets.set_abstraction(
        builder, points_1, features_1, "joint_encoder.sa2_joint.conv.local_nn", 0.33, 0.6, [131, 128, 128, 256])
    whole = joint_sets.global_abstraction(builder, points_2, features_2, "joint_encoder.sa3_joint.nn", [259, 256, 256, 512])
    # From the one point of the whole to the coarse level, the nearest point is that one.
    coarse = builder.perceptron(beside_every_row(builder, whole, features_2, 512), "joint_encoder.fp3_joint.nn", [768, 256, 256])
    middle = joint_sets.propagated(
        builder, joint_sets.interpolated(builder, points_2, coarse, points_1), features_1, "joint_encoder.fp2_joint.nn", [384, 128, 128])
    fine = joint_sets.propagated(
        builder, joint_sets.interpolated(builder, points_1, middle, "joints"), side, "joint_encoder.fp1_joint.nn", [129, 128, 128])
    hidden = builder.perceptron(beside_every_row(builder, shape_code(builder, [448, 128]), fine, 128), "back_layers.0", [256, 200, 64])
    return builder.add("Squeeze", builder.linear(hidden, "back_layers.1", 64, 1), builder.integers([1]))


def skin(builder: GraphBuilder) -> str:
    """An empty slot is read as the nearest bone once more, as in the paper's program, and gets no weight."""
    shape_inputs(builder)
    builder.input("bone_features", ["V", BONES * BONE_CHANNELS])
    builder.input("bone_mask", ["V", BONES])
    there = builder.add("Greater", "bone_mask", builder.number(0.5))
    by_bone = builder.add("Reshape", "bone_features", builder.integers([-1, BONES, BONE_CHANNELS]))
    nearest, _ = builder.split(by_bone, [1, BONES - 1], axis=1)
    padded = builder.add("Where", builder.add("Unsqueeze", there, builder.integers([2])), by_bone, nearest)
    logits = skin_head(builder, builder.add("Reshape", padded, builder.integers([-1, BONES * BONE_CHANNELS])))
    return builder.add("Where", there, logits, builder.number(EMPTY_SLOT_LOGIT))


@dataclass(frozen=True)
class PublishedNetwork:
    """One network as the program runs it."""

    checkpoint: str  # which of the four files holds its weights
    build: Callable[[GraphBuilder], str]
    output: str
    shape: tuple

    def graph(self) -> tuple[GraphBuilder, str]:
        builder = GraphBuilder()
        return builder, self.build(builder)

    def weights(self) -> dict[str, list[int]]:
        """Name -> shape."""
        return self.graph()[0].weights

    def inputs(self) -> list[str]:
        return list(self.graph()[0].inputs)

    def model(self, values: dict[str, np.ndarray]) -> onnx.ModelProto:
        builder, result = self.graph()
        return builder.model(result, self.output, list(self.shape), values)


NETWORKS = {
    "rignet_displacement": PublishedNetwork("joint", displacement, "displacement", ("V", 3)),
    "rignet_attention": PublishedNetwork("joint", attention, "attention_logit", ("V",)),
    "rignet_bone": PublishedNetwork("bone", bone, "bone_logit", ("P",)),
    "rignet_root": PublishedNetwork("root", root, "root_logit", ("J",)),
    "rignet_skin": PublishedNetwork("skin", skin, "skin_logit", ("V", BONES)),
}
CHECKPOINTS = tuple(dict.fromkeys(network.checkpoint for network in NETWORKS.values()))
