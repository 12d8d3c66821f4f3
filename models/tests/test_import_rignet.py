"""The importer of published checkpoints: what it reads, what it refuses, and that the graphs compute what the reference does.

Checkpoints of the full size are made under the weight rule of ``golden.py`` and stored as ``.npz``, so no PyTorch is needed.
The two small files under ``fixtures/`` were written by PyTorch 2.9's ``torch.save``, one in each layout, with the state of an
optimiser and a NumPy scalar beside the tensors.
"""

import hashlib
import json
import os
import pickle
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest

import golden
import import_rignet
from rigsmith_models import artifact, known_answer
from rigsmith_models.published import checkpoint, joint_sets
from rigsmith_models.published.checkpoint import CheckpointError
from rigsmith_models.published.graph_builder import GraphBuilder
from rigsmith_models.published.networks import CHECKPOINTS, NETWORKS

HERE = Path(__file__).parent
RULE_GRAPHS = HERE.parents[1] / "tests" / "golden"
REFERENCE = HERE.parents[2] / "shared" / "data" / "golden"  # not in the repository
LAYOUTS = ("saved_as_zip.pt", "saved_as_stream.pt")
REFERENCE_OUTPUTS = {
    "rignet_displacement": "net_joint_displacement", "rignet_attention": "net_attention_logit", "rignet_bone": "net_bone_logit",
    "rignet_root": "net_root_logit", "rignet_skin": "net_skin_logit",
}
# Joints in the middle whose third and fourth nearest sampled joints are mirror images, at the same distance to the last
# bit: which of the two is read is the library's choice.
TIED_JOINTS = {"8338_golden": [6, 8]}
every_network = pytest.mark.parametrize("name", NETWORKS)


def rule_state(kind: str) -> dict[str, np.ndarray]:
    """A checkpoint under the weight rule: tensors numbered as in the reference where its table is at hand."""
    table = REFERENCE / "weight_rule_tensors.json"
    if table.exists():
        rows = [(number, name, shape) for number, name, shape, _ in json.loads(table.read_text())[kind]]
    else:
        shapes = {n: s for network in NETWORKS.values() if network.checkpoint == kind for n, s in network.weights().items()}
        rows = [(number, name, shape) for number, (name, shape) in enumerate(shapes.items())]
    state = {name: golden.rule_tensor(number, name, shape) for number, name, shape in rows if shape}
    state["gcu.num_batches_tracked"] = np.array(1000)
    return {**state, "bandwidth": np.array([0.04], np.float32)} if kind == "joint" else state


@pytest.fixture(scope="module")
def states():
    return {kind: rule_state(kind) for kind in CHECKPOINTS}


def saved(folder: Path, kind: str, state: dict) -> Path:
    path = folder / f"{kind}.npz"
    np.savez(path, **state)
    return path


@pytest.fixture(scope="module")
def imported(states, tmp_path_factory):
    folder = tmp_path_factory.mktemp("import")
    sources = {kind: saved(folder, kind, state) for kind, state in states.items()}
    import_rignet.import_all(sources, folder / "models")
    return folder / "models"


def manifest_of(folder: Path) -> dict:
    return json.loads((folder / "manifest.json").read_text())


def run(path: Path, feed: dict) -> np.ndarray:
    return artifact.session(path).run(None, feed)[0]


# Reading


@pytest.mark.parametrize("file", LAYOUTS)
def test_both_layouts_of_torch_are_read_without_torch(file):
    tensors = checkpoint.read(HERE / "fixtures" / file)
    expected = {
        "a": np.arange(6, dtype=np.float32).reshape(2, 3), "b": np.array([1.5, -2.5], np.float16), "c": np.array(7),
        "turned": np.arange(6, dtype=np.float32).reshape(2, 3).T, "tail": np.array([4, 5], np.float32),
        "parameter": np.array([0.25], np.float32),
    }
    assert set(tensors) == set(expected)
    for name, values in expected.items():
        assert tensors[name].dtype == values.dtype
        np.testing.assert_array_equal(tensors[name], values)


class Hostile:
    def __init__(self, path: Path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


@pytest.mark.parametrize("layout", ["zip", "stream"])
def test_a_call_in_the_file_is_not_made(layout, tmp_path):
    path, mark = tmp_path / "hostile.pt", tmp_path / "mark"
    content = pickle.dumps({"state_dict": {"a": Hostile(mark)}}, 2)
    if layout == "zip":
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("archive/data.pkl", content)
    else:
        head = [pickle.dumps(value, 2) for value in (checkpoint.STREAM_MAGIC, checkpoint.STREAM_PROTOCOL, {"little_endian": True})]
        path.write_bytes(b"".join([*head, content, pickle.dumps([], 2)]))
    with pytest.raises(CheckpointError, match="holds no tensors"):
        checkpoint.read(path)
    assert not mark.exists()
    pickle.loads(content)
    assert mark.exists(), "the test's own call does nothing"


@pytest.mark.parametrize("offset, shape, strides", [(3, (2, 2), (2, 1)), (-1, (2,), (1,)), (0, (2,), (-1,)), (0, (7,), (1,))])
def test_a_view_beyond_its_storage_is_refused(offset, shape, strides):
    storage = np.arange(6, dtype=np.float32)
    with pytest.raises(CheckpointError, match="leaves its storage of 6"):
        checkpoint.Tensor(checkpoint.Storage("0", storage.dtype, 6), offset, shape, strides).values(storage)


@pytest.mark.parametrize("file", LAYOUTS)
def test_a_damaged_file_is_named(file, tmp_path):
    path = tmp_path / file
    content = (HERE / "fixtures" / file).read_bytes()
    for length in range(0, len(content), 97):
        path.write_bytes(content[:length])
        with pytest.raises(CheckpointError, match=str(path)):
            checkpoint.read(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(CheckpointError, match="nowhere.pt: there is no such file"):
        checkpoint.read(tmp_path / "nowhere.pt")


def test_another_zip_is_no_checkpoint(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.pt", "w") as archive:
        archive.writestr("readme.txt", "hello")
    with pytest.raises(CheckpointError, match="holds no data.pkl"):
        checkpoint.read(tmp_path / "a.pt")


# Checking


def refusal(tmp_path, kind: str, state: dict) -> str:
    with pytest.raises(CheckpointError) as error:
        import_rignet.import_all({kind: saved(tmp_path, kind, state)}, tmp_path / "models")
    assert not (tmp_path / "models").exists(), "nothing is written for a checkpoint that is refused"
    return str(error.value)


def test_the_checkpoint_of_another_network_is_refused(states, tmp_path):
    message = refusal(tmp_path, "root", states["bone"])
    assert "not a root checkpoint" in message and "bone" in message and "are unknown" in message


def test_a_missing_tensor_is_named(states, tmp_path):
    state = {name: values for name, values in states["skin"].items() if name != "cls_branch.6.bias"}
    assert "1 of 128 tensors are missing (cls_branch.6.bias)" in refusal(tmp_path, "skin", state)


def test_an_unknown_tensor_is_named(states, tmp_path):
    assert "1 are unknown (extra.weight)" in refusal(tmp_path, "skin", {**states["skin"], "extra.weight": np.zeros(3)})


def test_another_shape_is_named_with_both_sizes(states, tmp_path):
    message = refusal(tmp_path, "skin", {**states["skin"], "cls_branch.6.weight": np.zeros((6, 512), np.float32)})
    assert "cls_branch.6.weight is [6, 512], not [5, 512]" in message


def test_values_that_are_no_numbers_are_refused(states, tmp_path):
    message = refusal(tmp_path, "skin", {**states["skin"], "cls_branch.6.bias": np.full(5, np.nan, np.float32)})
    assert "no numbers: cls_branch.6.bias" in message


def test_a_folder_in_use_is_left_alone(states, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(CheckpointError, match="not empty"):
        import_rignet.import_all({"bone": saved(tmp_path, "bone", states["bone"])}, tmp_path)
    assert {p.name for p in tmp_path.iterdir()} == {"notes.txt", "bone.npz"}


# What is written


@every_network
def test_the_entry_describes_the_file(imported, name):
    entry, path = manifest_of(imported)["networks"][name], imported / f"{name}.onnx"
    assert entry["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest() and entry["bytes"] == path.stat().st_size
    graph = onnx.load(path).graph
    assert [i.name for i in graph.input] == [i["name"] for i in entry["inputs"]] and not any("Scatter" in n.op_type for n in graph.node)
    assert entry["inputs"] == artifact.described([i.name for i in graph.input])
    assert [d.dim_param or d.dim_value for d in graph.output[0].type.tensor_type.shape.dim] == entry["outputs"][0]["shape"]
    assert entry["parameters"] == sum(int(np.prod(s)) for s in NETWORKS[name].weights().values())
    assert entry["imported"]["file"] == f"{NETWORKS[name].checkpoint}.npz"


@every_network
def test_the_interface_is_one_that_the_service_serves(imported, name):
    """The service gives each network those of its inputs that it has: the published ones read neighbours where ours for bone and root
    read pairs of joints alone, and no medial offsets."""
    ours = json.loads((import_rignet.ARTIFACTS / "manifest.json").read_text())["networks"][name]
    entry = manifest_of(imported)["networks"][name]
    shape = ["positions", "one_ring", "geodesic_ball"]
    served = {"bone": [*shape, "joints", "pairs", "pair_features"], "root": [*shape, "joints"],
              "skin": [*shape, "bone_features", "bone_mask"]}.get(name.removeprefix("rignet_"), shape)
    assert entry["inputs"] == artifact.described(served) and entry["outputs"] == ours["outputs"]


@every_network
def test_the_known_answer_comes_out(imported, name):
    entry = manifest_of(imported)["networks"][name]
    values = run(imported / entry["file"], known_answer.inputs([i["name"] for i in entry["inputs"]])).astype(np.float64)
    test = entry["self_test"]
    np.testing.assert_allclose(values.reshape(-1)[:16], test["first"], rtol=0, atol=test["tolerance"])
    assert abs(values.mean() - test["mean"]) <= test["tolerance"] and abs(values.std() - test["std"]) <= test["tolerance"]
    assert values.std() > 0, "a constant output tells nothing"


def test_the_licence_says_whose_weights_these_are(imported):
    licence = manifest_of(imported)["licence"]
    assert licence["weights"] == "LicenseRef-RigNet-checkpoint AND (MIT OR Apache-2.0)"
    assert "not Rigsmith's" in licence["note"] and "heter_skin_net: Rigsmith's own" in licence["note"]
    assert "Xu, Zhou" in licence["attributions"][0] and (imported / "NOTICES.md").exists()


def test_a_network_that_is_not_imported_stays_ours(states, tmp_path):
    manifest = import_rignet.import_all({"bone": saved(tmp_path, "bone", states["bone"])}, tmp_path / "models")
    ours = json.loads((import_rignet.ARTIFACTS / "manifest.json").read_text())["networks"]
    for name, entry in manifest["networks"].items():
        assert hashlib.sha256((tmp_path / "models" / entry["file"]).read_bytes()).hexdigest() == entry["sha256"]
        assert (entry == ours[name]) == (name != "rignet_bone")


def test_the_learned_bandwidth_is_kept(imported):
    assert manifest_of(imported)["networks"]["rignet_displacement"]["bandwidth"] == pytest.approx(0.04)


def test_the_command_asks_for_the_licence_and_names_what_it_did(states, tmp_path):
    bone = saved(tmp_path, "bone", states["bone"])

    def command(*further: str):
        script = [sys.executable, str(HERE.parent / "import_rignet.py"), str(tmp_path / "models")]
        return subprocess.run([*script, "--bone", str(bone), *further], capture_output=True, text=True, check=False)

    refused = command()
    assert refused.returncode == 2 and "--accept-licence" in refused.stderr and not (tmp_path / "models").exists()
    done = command("--accept-licence")
    assert done.returncode == 0, done.stderr
    assert "rignet_bone: from bone.npz" in done.stdout and "rignet_root: Rigsmith's own" in done.stdout
    again = command("--accept-licence")
    assert again.returncode == 1 and again.stderr.startswith("import_rignet: ") and "not empty" in again.stderr


# What the graphs compute


@pytest.mark.parametrize("short", ["displacement", "attention", "skin"])
def test_the_imported_graph_is_the_weight_free_one_with_its_weights(imported, states, short):
    name = f"rignet_{short}"
    feed = known_answer.inputs([i["name"] for i in manifest_of(imported)["networks"][name]["inputs"]])
    rule = onnxruntime.InferenceSession(str(RULE_GRAPHS / f"{name}_rule.onnx"), providers=["CPUExecutionProvider"])
    every = {**feed, **states[NETWORKS[name].checkpoint]}
    expected = rule.run(None, {i.name: every[i.name] for i in rule.get_inputs()})[0]
    got = run(imported / f"{name}.onnx", feed)
    np.testing.assert_allclose(got, expected.reshape(got.shape), rtol=0, atol=1e-4 * expected.std())


def test_an_empty_slot_is_the_nearest_bone_again_and_gets_no_weight(imported):
    feed = known_answer.inputs(["positions", "one_ring", "geodesic_ball", "bone_features", "bone_mask"])
    bones = feed["bone_features"].reshape(-1, 5, 8).copy()
    bones[:, 3:] = bones[:, :1]
    full = run(imported / "rignet_skin.onnx", {**feed, "bone_features": bones.reshape(-1, 40)})
    feed["bone_mask"][:, 3:] = 0
    masked = run(imported / "rignet_skin.onnx", feed)
    np.testing.assert_allclose(masked[:, :3], full[:, :3], rtol=0, atol=1e-4)
    assert (masked[:, 3:] <= -1e4).all()


def dense_layers(x: np.ndarray, name: str, weights: dict) -> np.ndarray:
    """Linear, ReLU, BatchNorm for as many layers as ``weights`` has."""
    for k in range(sum(n.startswith(f"{name}.") and n.endswith(".0.weight") for n in weights)):
        x = np.maximum(x @ weights[f"{name}.{k}.0.weight"].T + weights[f"{name}.{k}.0.bias"], 0)
        scale, shift, mean, variance = (weights[f"{name}.{k}.2.{p}"] for p in ("weight", "bias", "running_mean", "running_var"))
        x = (x - mean) / np.sqrt(variance + 1e-5) * scale + shift
    return x


def set_abstraction_by_loops(points, features, weights, ratio: float, radius: float):
    picked = [0]
    while len(picked) < int(np.ceil(ratio * len(points))):
        picked.append(int(np.argmax([min(np.linalg.norm(p - points[k]) for k in picked) for p in points])))
    rows = []
    for number, pick in enumerate(picked):
        near = [j for j in range(len(points)) if np.linalg.norm(points[j] - points[pick]) <= radius][:64]
        sources = sorted({*near, number})
        messages = np.array([[*features[j], *(points[j] - points[pick])] for j in sources], np.float32)
        rows.append(dense_layers(messages, "nn", weights).max(0))
    return points[picked], np.array(rows)


@pytest.mark.parametrize("count, ratio, radius", [(1, 0.33, 0.6), (7, 0.33, 0.6), (20, 0.999, 0.2), (90, 0.999, 2.0)])
def test_set_abstraction_is_what_its_loops_say(count, ratio, radius):
    rng = np.random.default_rng(count)
    points, features = rng.random((count, 3), np.float32), rng.random((count, 2), np.float32)
    builder = GraphBuilder()
    builder.input("points", ["n", 3])
    builder.input("features", ["n", 2])
    targets, pooled = joint_sets.set_abstraction(builder, "points", "features", "nn", ratio, radius, [5, 8, 6])
    weights = {name: golden.rule_tensor(number, name, shape) for number, (name, shape) in enumerate(builder.weights.items())}
    result = builder.add("Concat", targets, pooled, axis=1)
    model = builder.model(result, "out", ["s", 9], weights).SerializeToString()
    session = onnxruntime.InferenceSession(model, providers=["CPUExecutionProvider"])
    got = session.run(None, {"points": points, "features": features})[0]
    expected = np.concatenate(set_abstraction_by_loops(points, features, weights, ratio, radius), axis=1)
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-5)


@pytest.mark.parametrize("count", [1, 2, 9])
def test_interpolation_is_by_inverse_squared_distance(count):
    rng = np.random.default_rng(count)
    points, features = rng.random((count, 3), np.float32), rng.random((count, 4), np.float32)
    targets = np.concatenate([points[:1], rng.random((5, 3), np.float32)])
    builder = GraphBuilder()
    names = [builder.input(n, ["n" if n != "targets" else "m", c]) for n, c in (("points", 3), ("features", 4), ("targets", 3))]
    model = builder.model(joint_sets.interpolated(builder, *names), "out", ["m", 4], {})
    session = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
    got = session.run(None, {"points": points, "features": features, "targets": targets})[0]
    np.testing.assert_allclose(got[0], features[0], rtol=0, atol=1e-6)
    for target, row in zip(targets[1:], got[1:]):
        squared = ((points - target) ** 2).sum(1)
        near = squared.argsort()[:3]
        np.testing.assert_allclose(row, np.average(features[near], axis=0, weights=1 / squared[near]), rtol=0, atol=1e-5)


@pytest.mark.skipif(not REFERENCE.exists(), reason="the reference's outputs are not in the repository")
@every_network
def test_the_reference_outputs_come_out(imported, name):
    for path in sorted(REFERENCE.glob("*_golden.npz")):
        with np.load(path) as data:
            count = len(data["vertices"])
            every = {
                "positions": data["vertices"].astype(np.float32), "one_ring": golden.neighbour_table(data["tpl_edges"], count),
                "geodesic_ball": golden.neighbour_table(data["geo_edges_sampled"], count), "joints": data["joints"].astype(np.float32),
                "pairs": data["pairs"].astype(np.int64), "pair_features": data["pair_attr"].astype(np.float32),
                "bone_features": data["skin_features"].astype(np.float32), "bone_mask": np.ones((count, 5), np.float32),
            }
            expected = data[REFERENCE_OUTPUTS[name]]
        got = run(imported / f"{name}.onnx", {k: every[k] for k in NETWORKS[name].inputs()})
        difference = np.abs(got - expected.reshape(got.shape))
        if name == "rignet_root":
            assert got.argmax() == expected.argmax()
            difference = np.delete(difference, TIED_JOINTS.get(path.stem, []))
        share = difference.max() / expected.std()
        assert share < golden.TOLERANCE, f"{path.stem}: {share:.1e} of the deviation"
