"""The shipped files are what the manifest says. Needs no PyTorch."""

import hashlib
import json
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest

from rigsmith_models import known_answer

ARTIFACTS = Path(__file__).parents[1] / "artifacts"
MANIFEST = json.loads((ARTIFACTS / "manifest.json").read_text())
NETWORKS = MANIFEST["networks"]
FORBIDDEN = {"Scatter", "ScatterElements", "ScatterND"}
every_network = pytest.mark.parametrize("name", NETWORKS)
ELEMENT = {onnx.TensorProto.FLOAT: "float32", onnx.TensorProto.INT64: "int64"}


def run(name: str, feed: dict) -> np.ndarray:
    session = onnxruntime.InferenceSession(str(ARTIFACTS / NETWORKS[name]["file"]), providers=["CPUExecutionProvider"])
    return session.run(None, feed)[0]


def test_the_five_networks_of_rignet_and_heter_skin_net_are_there():
    assert set(NETWORKS) == {f"rignet_{n}" for n in ("displacement", "attention", "bone", "root", "skin")} | {"heter_skin_net"}


def test_all_files_together_are_small_enough_for_the_repository():
    sizes = [p.stat().st_size for p in ARTIFACTS.glob("*.onnx")]
    assert max(sizes) <= 16 << 20 and sum(sizes) <= 20 << 20


def test_no_file_lies_there_that_the_manifest_does_not_name():
    assert {p.name for p in ARTIFACTS.glob("*.onnx")} == {entry["file"] for entry in NETWORKS.values()}


@every_network
def test_the_digest_is_that_of_the_file(name):
    assert hashlib.sha256((ARTIFACTS / NETWORKS[name]["file"]).read_bytes()).hexdigest() == NETWORKS[name]["sha256"]


@every_network
def test_no_operator_is_used_that_is_slow_or_wrong_in_the_runtime(name):
    graph = onnx.load(ARTIFACTS / NETWORKS[name]["file"]).graph
    assert not {node.op_type for node in graph.node} & FORBIDDEN


@every_network
def test_names_types_and_symbolic_shapes_are_those_of_the_file(name):
    model = onnx.load(ARTIFACTS / NETWORKS[name]["file"])
    assert model.opset_import[0].version == NETWORKS[name]["opset"]
    for values, entries in ((model.graph.input, NETWORKS[name]["inputs"]), (model.graph.output, NETWORKS[name]["outputs"])):
        found = [{
            "name": value.name, "dtype": ELEMENT[value.type.tensor_type.elem_type],
            "shape": [d.dim_param or d.dim_value for d in value.type.tensor_type.shape.dim],
        } for value in values]
        assert found == entries


@every_network
def test_large_initialisers_are_stored_as_float16(name):
    for tensor in onnx.load(ARTIFACTS / NETWORKS[name]["file"]).graph.initializer:
        assert tensor.data_type != onnx.TensorProto.FLOAT or np.prod(tensor.dims) < 256


@every_network
def test_the_known_answer_comes_out(name):
    entry = NETWORKS[name]
    values = run(name, known_answer.inputs([i["name"] for i in entry["inputs"]])).astype(np.float64)
    expected, tolerance = entry["self_test"], entry["self_test"]["tolerance"]
    np.testing.assert_allclose(values.reshape(-1)[:16], expected["first"][: values.size], rtol=0, atol=tolerance)
    assert abs(values.mean() - expected["mean"]) <= tolerance and abs(values.std() - expected["std"]) <= tolerance


@every_network
def test_padding_a_neighbour_row_with_its_own_vertex_changes_nothing(name):
    feed = known_answer.inputs([i["name"] for i in NETWORKS[name]["inputs"]])
    padded = dict(feed)
    for table in {"one_ring", "geodesic_ball", "joint_neighbours"} & feed.keys():
        padded[table] = np.concatenate([feed[table], np.repeat(feed[table][:, :1], 5, axis=1)], axis=1)
    np.testing.assert_allclose(run(name, feed), run(name, padded), rtol=0, atol=1e-5)


@every_network
def test_the_order_of_the_vertices_does_not_matter(name):
    feed = known_answer.inputs([i["name"] for i in NETWORKS[name]["inputs"]])
    order = np.random.default_rng(0).permutation(known_answer.VERTEX_COUNT)
    place = np.argsort(order)
    shuffled = dict(feed)
    for key in {"positions", "medial_offsets", "bone_features", "bone_mask", "links", "link_mask", "link_features"} & feed.keys():
        shuffled[key] = feed[key][order]
    for key in {"one_ring", "geodesic_ball"} & feed.keys():
        shuffled[key] = place[feed[key]][order]
    if "joint_links" in feed:
        vertex, slot = np.divmod(feed["joint_links"], known_answer.LINKS)
        shuffled["joint_links"] = place[vertex] * known_answer.LINKS + slot
    expected = run(name, feed)
    if NETWORKS[name]["outputs"][0]["shape"][0] == "V":
        expected = expected[order]
    np.testing.assert_allclose(run(name, shuffled), expected, rtol=0, atol=1e-4)


def test_a_bone_has_no_direction():
    feed = known_answer.inputs([i["name"] for i in NETWORKS["rignet_bone"]["inputs"]])
    turned = {**feed, "pairs": np.ascontiguousarray(feed["pairs"][:, ::-1])}
    np.testing.assert_allclose(run("rignet_bone", feed), run("rignet_bone", turned), rtol=0, atol=1e-5)


def test_a_padded_bone_slot_gets_no_weight_whatever_it_holds():
    feed = known_answer.inputs([i["name"] for i in NETWORKS["rignet_skin"]["inputs"]])
    feed["bone_mask"][:, 3:] = 0
    other = {**feed, "bone_features": feed["bone_features"].copy()}
    other["bone_features"][:, 24:] = 7.0
    one, two = run("rignet_skin", feed), run("rignet_skin", other)
    assert (one[:, 3:] <= -1e4).all()
    np.testing.assert_array_equal(one, two)


def test_a_vertex_on_a_bone_is_no_overflow():
    feed = known_answer.inputs([i["name"] for i in NETWORKS["rignet_skin"]["inputs"]])
    feed["bone_features"][:, 6] = 1e10
    assert np.isfinite(run("rignet_skin", feed)).all()


def test_every_source_that_needs_a_notice_is_named():
    assert MANIFEST["licence"]["weights"] and len(MANIFEST["licence"]["attributions"]) >= 15
