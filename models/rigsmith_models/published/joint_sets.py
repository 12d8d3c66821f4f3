"""PointNet++ [Qi et al. 2017] over the joints, as the published bone and root networks use it.

Joints are few, so neighbourhoods are dense masks ``[targets, points]`` and a maximum under the mask: no scatter. Only
farthest-point sampling is a loop, over rows of one distance table.
"""

from onnx import TensorProto, helper

from .graph_builder import GraphBuilder

NEIGHBOURS_MAX = 64  # of a picked point
LOWEST = -3.0e38
SQUARED_DISTANCE_MIN = 1e-16
INTERPOLATION_POINTS = 3


def count(builder: GraphBuilder, x: str) -> str:
    """[n, ...] -> [1], n."""
    return builder.add("Shape", x, start=0, end=1)


def squared_distances(builder: GraphBuilder, a: str, b: str) -> str:
    """[n, 3], [m, 3] -> [n, m]."""
    rows, columns = builder.add("Unsqueeze", a, builder.integers([1])), builder.add("Unsqueeze", b, builder.integers([0]))
    difference = builder.add("Sub", rows, columns)
    return builder.add("ReduceSum", builder.add("Mul", difference, difference), builder.integers([2]), keepdims=0)


def farthest_points(builder: GraphBuilder, distances: str, ratio: float) -> str:
    """[n, n] squared distances -> [ceil(ratio n)] indices: point 0, then always the point farthest from those picked.

    The published program starts at a random point; point 0 makes the same mesh give the same rig.
    """
    share = builder.add("Mul", builder.add("Cast", count(builder, distances), to=TensorProto.FLOAT), builder.number(ratio))
    picks = builder.add("Squeeze", builder.add("Cast", builder.add("Ceil", share), to=TensorProto.INT64), builder.integers([0]))
    first = builder.add("Squeeze", builder.integers([0]), builder.integers([0]))
    unpicked = builder.add("ReduceMax", distances, builder.integers([1]), keepdims=0)
    body = helper.make_graph(
        [
            helper.make_node("Gather", [distances, "pick"], ["from_pick"], axis=0),
            helper.make_node("Min", ["nearest", "from_pick"], ["nearest_next"]),
            helper.make_node("ArgMax", ["nearest_next"], ["pick_next"], axis=0, keepdims=0),
            helper.make_node("Identity", ["go_on"], ["go_on_next"]),
            helper.make_node("Identity", ["pick"], ["picked"]),
        ],
        "farthest_point",
        [
            helper.make_tensor_value_info("step", TensorProto.INT64, []),
            helper.make_tensor_value_info("go_on", TensorProto.BOOL, []),
            helper.make_tensor_value_info("nearest", TensorProto.FLOAT, ["n"]),
            helper.make_tensor_value_info("pick", TensorProto.INT64, []),
        ],
        [
            helper.make_tensor_value_info("go_on_next", TensorProto.BOOL, []),
            helper.make_tensor_value_info("nearest_next", TensorProto.FLOAT, ["n"]),
            helper.make_tensor_value_info("pick_next", TensorProto.INT64, []),
            helper.make_tensor_value_info("picked", TensorProto.INT64, []),
        ],
    )
    return builder.add("Loop", picks, "", unpicked, first, outputs=3, body=body)[2]


def set_abstraction(
    builder: GraphBuilder, points: str, features: str | None, name: str, ratio: float, radius: float, channels: list[int],
) -> tuple[str, str]:
    """[n, 3], [n, C] -> picked points [s, 3] and their features [s, channels[-1]], the maximum over each one's neighbours.

    Neighbours of pick k: up to 64 points within the radius (the first by index), and **point number k** of the input,
    wherever it lies. That last one is no neighbour in any sense, but the published weights were trained with it.
    """
    distances = squared_distances(builder, points, points)
    picked = farthest_points(builder, distances, ratio)
    targets, rows = builder.add("Gather", points, picked, axis=0), builder.add("Gather", distances, picked, axis=0)
    within = builder.add("LessOrEqual", rows, builder.number(radius * radius))
    rank = builder.add("CumSum", builder.add("Cast", within, to=TensorProto.INT64), builder.integers([1]))
    within = builder.add("And", within, builder.add("LessOrEqual", rank, builder.integers([NEIGHBOURS_MAX])))
    same_number = builder.add("Cast", builder.add("EyeLike", rows, dtype=TensorProto.INT64), to=TensorProto.BOOL)
    neighbours = builder.add("Unsqueeze", builder.add("Or", within, same_number), builder.integers([2]))

    every_point = builder.add("Unsqueeze", points, builder.integers([0]))
    message = builder.add("Sub", every_point, builder.add("Unsqueeze", targets, builder.integers([1])))
    size = builder.add("Shape", rows)
    if features is not None:
        every = builder.add("Expand", features, builder.add("Concat", size, builder.integers([channels[0] - 3]), axis=0))
        message = builder.add("Concat", every, message, axis=2)
    flat = builder.perceptron(builder.add("Reshape", message, builder.integers([-1, channels[0]])), name, channels)
    flat = builder.add("Reshape", flat, builder.add("Concat", size, builder.integers([channels[-1]]), axis=0))
    masked = builder.add("Where", neighbours, flat, builder.number(LOWEST))
    return targets, builder.add("ReduceMax", masked, builder.integers([1]), keepdims=0)


def global_abstraction(builder: GraphBuilder, points: str, features: str, name: str, channels: list[int]) -> str:
    """[n, 3], [n, C] -> [1, channels[-1]]."""
    return builder.global_maximum(builder.perceptron(builder.add("Concat", features, points, axis=1), name, channels))


def interpolated(builder: GraphBuilder, points: str, features: str, targets: str) -> str:
    """[n, 3], [n, C], [m, 3] -> [m, C]: the mean of the 3 nearest points' features by inverse squared distance."""
    distances = squared_distances(builder, targets, points)
    neighbours = builder.add("Min", builder.integers([INTERPOLATION_POINTS]), count(builder, points))
    nearest, index = builder.add("TopK", distances, neighbours, outputs=2, axis=1, largest=0)
    weight = builder.add("Reciprocal", builder.add("Max", nearest, builder.number(SQUARED_DISTANCE_MIN)))
    near = builder.add("Gather", features, index, axis=0)
    weighted = builder.add("Mul", near, builder.add("Unsqueeze", weight, builder.integers([2])))
    total = builder.add("ReduceSum", weight, builder.integers([1]), keepdims=1)
    return builder.add("Div", builder.add("ReduceSum", weighted, builder.integers([1]), keepdims=0), total)


def propagated(builder: GraphBuilder, coarse: str, skip: str, name: str, channels: list[int]) -> str:
    """Features from the coarser level, joined with those of this level."""
    return builder.perceptron(builder.add("Concat", coarse, skip, axis=1), name, channels)
