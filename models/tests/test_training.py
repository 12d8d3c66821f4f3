"""Networks and training loop. Needs PyTorch; skipped without it."""

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from rigsmith_models.data import write_cache  # noqa: E402
from rigsmith_models.data.sampling import Pool  # noqa: E402
from rigsmith_models.folding import folded  # noqa: E402
from rigsmith_models.layers import EdgeConv  # noqa: E402
from rigsmith_models.networks import NETWORKS  # noqa: E402
from rigsmith_models.train.trainer import TRAINED, Run, Settings, averaged_network  # noqa: E402

import export  # noqa: E402

every_network = pytest.mark.parametrize("name", NETWORKS)


@pytest.fixture
def pool(tmp_path, stick_figures) -> Pool:
    write_cache(tmp_path / "cache.npz", stick_figures)
    return Pool([tmp_path / "cache.npz"])


def settings(network: str, **changes) -> Settings:
    return Settings(**{"network": network, "width": 0.25, "characters_per_step": 2, "steps": 40, "mixed_precision": False, **changes})


def test_forty_steps_are_twenty_and_twenty_more(pool, tmp_path):
    whole = Run(tmp_path / "whole", settings("rignet_joint_pair"), "cpu", resume=False)
    losses = [whole.train_step(pool) for _ in range(40)]
    first = Run(tmp_path / "parts", settings("rignet_joint_pair"), "cpu", resume=False)
    parts = [first.train_step(pool) for _ in range(20)]
    first.save()
    second = Run(tmp_path / "parts", settings("rignet_joint_pair"), "cpu", resume=True)
    parts += [second.train_step(pool) for _ in range(20)]
    np.testing.assert_allclose(parts, losses, rtol=0, atol=1e-3)


def test_batches_are_the_same_wherever_they_are_made(pool, tmp_path):
    run = Run(tmp_path / "run", settings("rignet_joint_pair"), "cpu", resume=False)
    here, there = run.batches(pool, workers=0), run.batches(pool, workers=2)
    for mine, theirs, _ in zip(here, there, range(5)):
        assert torch.equal(mine["positions"], theirs["positions"]) and torch.equal(mine["joints"], theirs["joints"])


def test_a_run_by_the_clock_goes_through_its_whole_schedule(pool, tmp_path):
    run = Run(tmp_path / "clock", settings("rignet_joint_pair", steps=10**7), "cpu", resume=False)
    run.train(pool, minutes=0.05, by_clock=True)
    assert run.settings.steps == run.step > 1
    assert run.optimiser.param_groups[0]["lr"] < 0.3 * run.settings.learning_rate
    network, record = averaged_network(tmp_path / "clock" / "averages.pt")
    assert record["step"] == run.step
    for name, value in network.state_dict().items():
        np.testing.assert_allclose(value, run.average[name], rtol=1e-3, atol=1e-6)


def test_fine_tuning_starts_from_the_pair(pool, tmp_path):
    pair = Run(tmp_path / "rignet_joint_pair_a", settings("rignet_joint_pair"), "cpu", resume=False)
    pair.train_step(pool)
    pair.save()
    stage = Run(tmp_path / "rignet_joint_stage_a", settings("rignet_joint_stage"), "cpu", resume=False)
    for name, value in stage.network.state_dict().items():
        assert torch.equal(value, pair.average[name])


@pytest.mark.parametrize("name", TRAINED)
def test_training_lowers_the_loss(pool, tmp_path, name):
    """On one batch: the networks start from geometry, which stick figures leave little to improve on in thirty steps of others."""
    run = Run(tmp_path / name, settings(name), "cpu", resume=False)
    characters = pool.draw(2, 0.0, np.random.default_rng(1), 1.0)
    batch = run.objective.batch(characters, 0.0, np.random.default_rng(2), "cpu")
    optimiser = torch.optim.Adam(run.network.parameters(), lr=1e-3)
    losses = []
    for _ in range(40):
        torch.manual_seed(0)
        loss = run.objective.loss(run.network.train(), batch)
        losses.append(float(loss.detach()))
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    assert np.isfinite(losses).all() and min(losses[-5:]) < losses[0]


def unsettled(network: torch.nn.Module) -> torch.nn.Module:
    """Random statistics and scales of both signs, so that folding them is not trivial."""
    generator = torch.Generator().manual_seed(3)
    for module in network.modules():
        if isinstance(module, torch.nn.BatchNorm1d):
            module.running_mean.uniform_(-0.3, 0.3, generator=generator)
            module.running_var.uniform_(0.5, 1.5, generator=generator)
            torch.nn.init.uniform_(module.weight, -1.2, 1.2, generator=generator)
            torch.nn.init.uniform_(module.bias, -0.3, 0.3, generator=generator)
    out = getattr(network, "body", network).out
    torch.nn.init.uniform_(out.weight, -0.1, 0.1, generator=generator)
    return network.eval()


class NaiveEdgeConv(torch.nn.Module):
    """RigNet, Eq. 3 as it is written: the message of every edge from [x_v, x_u - x_v], normalised, then the maximum."""

    def __init__(self, convolution: EdgeConv):
        super().__init__()
        self.of = convolution

    def forward(self, x, neighbours):
        of, (count, degree) = self.of, neighbours.shape
        own = x[:, None].expand(-1, degree, -1)
        message = torch.cat([own, x[neighbours] - own], dim=2).reshape(count * degree, -1)
        message = of.first_norm(torch.relu(of.first(message)))
        return of.second_norm(torch.relu(of.second(message))).reshape(count, degree, -1).amax(1)


@every_network
@pytest.mark.parametrize("width", [0.25, 0.5])
def test_the_folded_network_is_the_naive_one(name, width):
    torch.manual_seed(0)
    network = unsettled(NETWORKS[name](width, "batch"))
    feed = export.random_inputs(network.inputs, 5, {"V": 150, "K1": 8, "K2": 11, "K3": 5, "J": 12, "P": 66})
    inputs = [torch.from_numpy(feed[n]) for n in network.inputs]
    exported = folded(network)
    for label, module in list(network.named_modules()):
        if isinstance(module, EdgeConv):
            parent, _, last = label.rpartition(".")
            setattr(network.get_submodule(parent), last, NaiveEdgeConv(module))
    with torch.no_grad():
        torch.testing.assert_close(exported(*inputs), network(*inputs), rtol=1e-4, atol=1e-4)


@every_network
def test_the_exported_graph_gives_what_pytorch_gives_at_sizes_it_was_not_traced_with(name, tmp_path):
    torch.manual_seed(0)
    network = unsettled(NETWORKS[name](0.25, "batch"))
    export.to_onnx(network, tmp_path / "graph.onnx")
    assert export.parity(network, tmp_path / "graph.onnx") < export.PARITY_TOLERANCE


@every_network
def test_characters_of_a_batch_do_not_see_each_other(name):
    torch.manual_seed(0)
    network = unsettled(NETWORKS[name](0.25, "batch"))
    sizes = {"V": 60, "K1": 6, "K2": 9, "K3": 4, "J": 5, "P": 10}
    feeds = [export.random_inputs(network.inputs, seed, sizes) for seed in (1, 2)]
    shift = {"one_ring": sizes["V"], "geodesic_ball": sizes["V"], "pairs": sizes["J"], "joint_neighbours": sizes["J"],
             "links": sizes["J"], "joint_links": sizes["V"] * export.LINKS_PER_VERTEX}
    both = [torch.from_numpy(np.concatenate([feeds[0][n], feeds[1][n] + shift.get(n, 0)]).astype(feeds[0][n].dtype)) for n in network.inputs]
    with torch.no_grad():
        alone = torch.cat([network(*(torch.from_numpy(f[n]) for n in network.inputs)) for f in feeds])
        torch.testing.assert_close(network(*both, 2), alone, rtol=1e-4, atol=1e-4)
