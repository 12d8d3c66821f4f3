"""The weight-free reference graphs under tests/golden, and that the networks we train are the same function."""

from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest

import golden

GOLDEN = Path(__file__).parents[2] / "tests" / "golden"
BUILDERS = {
    "displacement": lambda: golden.joint_network("jointnet", "displacement", 3),
    "attention": lambda: golden.joint_network("masknet", "attention_logit", 1),
    "skin": golden.skin_network,
}


@pytest.mark.parametrize("name", BUILDERS)
def test_the_committed_graph_is_what_the_script_writes(name):
    committed, built = onnx.load(GOLDEN / f"rignet_{name}_rule.onnx").graph, BUILDERS[name]().graph
    assert [n.op_type for n in committed.node] == [n.op_type for n in built.node]
    assert [i.name for i in committed.input] == [i.name for i in built.input]


@pytest.mark.parametrize("name", BUILDERS)
def test_the_graph_holds_no_weights_and_no_scatter(name):
    graph = onnx.load(GOLDEN / f"rignet_{name}_rule.onnx").graph
    assert all(t.data_type == onnx.TensorProto.INT64 for t in graph.initializer)
    assert not any("Scatter" in n.op_type for n in graph.node)


def test_the_weight_rule_is_splitmix64():
    first_of_seed_0 = 0xE220A8397B1DCDAF  # the published first output of SplitMix64 for seed 0
    assert golden.rule_tensor(0, "x.running_var", [1])[0] == pytest.approx(0.5 + first_of_seed_0 / 2**64, abs=1e-6)


def reference_weights(state: dict, prefix: str) -> dict[str, np.ndarray]:
    """Weights of a RigNetDisplacement under the names of the published network, those that read medial offsets left out."""
    state = dict(state)
    for layer in ("one_ring", "geodesic_ball"):
        key = f"body.convolution_1.{layer}.first.weight"
        state[key] = state[key][:, [0, 1, 2, 6, 7, 8]]  # of both halves, the vertex's own and the offset to a neighbour's
    head_local = state["body.head_local.weight"].numpy()
    head_local = np.concatenate([head_local[:, :3], head_local[:, 6:]], axis=1)
    names = {"shape_code.0": "mlp_glb.0", "head_last.0": "mlp_tramsform.0.1"}
    pieces = {}
    for k in (1, 2, 3):
        names[f"convolution_{k}.join"] = f"gcu_{k}.mlp.0"
        for ours, theirs in (("one_ring", "tpl"), ("geodesic_ball", "geo")):
            layer, target = f"convolution_{k}.{ours}", f"gcu_{k}.edge_conv_{theirs}.nn"
            pieces |= {f"{layer}.first": f"{target}.0.0", f"{layer}.first_norm": f"{target}.0.2",
                       f"{layer}.second": f"{target}.1.0", f"{layer}.second_norm": f"{target}.1.2"}
    for ours, theirs in names.items():
        pieces |= {f"{ours}.linear": f"{theirs}.0", f"{ours}.norm": f"{theirs}.2"}
    pieces |= {"head_norm": "mlp_tramsform.0.0.2", "out": "mlp_tramsform.2"}
    weights = {}
    for key, value in state.items():
        module, _, parameter = key.removeprefix("body.").rpartition(".")
        if module in pieces and parameter != "num_batches_tracked":
            weights[f"{prefix}.{pieces[module]}.{parameter}"] = value.numpy()
    head = [state["body.head_global.weight"].numpy(), head_local]
    weights[f"{prefix}.mlp_tramsform.0.0.0.weight"] = np.concatenate(head, axis=1)
    weights[f"{prefix}.mlp_tramsform.0.0.0.bias"] = state["body.head_local.bias"].numpy()
    return weights


def test_the_network_that_we_train_is_the_published_one_where_it_knows_no_medial_offsets():
    torch = pytest.importorskip("torch")
    import export
    from test_training import unsettled
    from rigsmith_models.rignet import RigNetDisplacement

    torch.manual_seed(0)
    network = unsettled(RigNetDisplacement(1.0, "batch"))
    feed = export.random_inputs(network.inputs, 2, {"V": 80, "K1": 7, "K2": 9})
    feed["medial_offsets"] = np.zeros_like(feed["positions"])
    session = onnxruntime.InferenceSession(str(GOLDEN / "rignet_displacement_rule.onnx"), providers=["CPUExecutionProvider"])
    published = session.run(None, {**{n: v for n, v in feed.items() if n != "medial_offsets"}, **reference_weights(network.state_dict(), "jointnet")})[0]
    with torch.no_grad():
        ours = network(*(torch.from_numpy(feed[n]) for n in network.inputs)).numpy()
    np.testing.assert_allclose(ours, published, rtol=0, atol=1e-4)
