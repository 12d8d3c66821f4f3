"""A training run that can be stopped at any moment and goes on as if it had not been.

Every random choice of step s derives from (seed, s); the state on disk is everything else. The learning rate depends
only on step / steps, so a run may be lengthened while its rate is still constant.
"""

import json
import math
import signal
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from torch import nn

from ..data.sampling import SAMPLINGS, Pool
from ..layers import EdgeConv
from ..networks import NETWORKS
from .joint_stage import JointStage
from .objectives import OBJECTIVES
from .skeleton_stage import SkeletonStage

# Fine-tuning before what it starts from: the last to have trained a network is named first.
STAGES = {"rignet_joint_stage": JointStage, "rignet_joint_pair": JointStage, "rignet_skeleton_stage": SkeletonStage}
# What is trained by itself: every network that is no part of a stage, and the stages.
PARTS = {name for stage in STAGES.values() for name in stage.parts.values()}
TRAINED = {**{name: network for name, network in NETWORKS.items() if name not in PARTS}, **STAGES}

CHECKPOINT_SECONDS = 30.0
LOG_STEPS = 50
COORDINATE_CHANNELS_MAX = 43  # a layer with at most so many inputs reads coordinates (SkinNet's first reads 43)


@dataclass
class Settings:
    network: str
    width: float = 0.5
    normalisation: str = "batch"
    steps: int = 6000
    characters_per_step: int = 4
    learning_rate: float = 2e-3
    warm_up: float = 0.03  # share of the steps
    decay_from: float = 0.5  # share of the steps after which the rate falls, by a cosine, to a hundredth
    weight_decay: float = 1e-2
    gradient_norm_max: float = 1.0
    average_decay: float = 0.998  # of the exponential moving average of the weights, which is what is evaluated and shipped
    seed: int = 7
    real_share: float = 0.5  # of the draws; the others are generated characters, half as many in the last part of the run
    mixed_precision: bool = True
    sampling: str = "sparse"  # of data.sampling.SAMPLINGS
    augmented: bool = True

    def rate(self, progress: float) -> float:
        """At a share of the schedule."""
        if progress < self.warm_up:
            return self.learning_rate * (progress / self.warm_up + 1 / self.steps)
        if progress < self.decay_from:
            return self.learning_rate
        fall = 0.5 * (1 + math.cos(math.pi * min((progress - self.decay_from) / (1 - self.decay_from), 1.0)))
        return self.learning_rate * (0.01 + 0.99 * fall)


class StepBatches(torch.utils.data.Dataset):
    """The batch of every step, made of (seed, step) alone, so in whichever process."""

    def __init__(self, settings: Settings, pool: Pool, objective, clock: "Clock"):
        self.settings, self.pool, self.objective, self.clock = settings, pool, objective, clock

    def __len__(self) -> int:
        return self.settings.steps

    def __getitem__(self, step: int) -> dict:
        rng = np.random.default_rng([self.settings.seed, step])
        progress = self.clock.progress(step)
        characters = self.pool.draw(self.settings.characters_per_step, progress, rng, self.settings.real_share)
        return self.objective.batch(characters, progress, rng, "cpu")


@dataclass
class Clock:
    """How far a run is: by its steps, or by the wall where the time is what is given (such a run cannot be repeated exactly)."""

    steps: int
    minutes: float | None = None
    started: float = 0.0

    def progress(self, step: int) -> float:
        if self.minutes is None:
            return step / max(self.steps, 1)
        return min((time.monotonic() - self.started) / 60 / self.minutes, 1.0)


class Run:
    """The state of one network in training, kept in ``folder``: checkpoint.pt and log.jsonl."""

    def __init__(self, folder: Path, settings: Settings, device: str, resume: bool):
        self.folder, self.settings, self.device = folder, settings, device
        torch.manual_seed(settings.seed)
        self.network = TRAINED[settings.network](settings.width, settings.normalisation).to(device)
        if settings.network == "rignet_joint_stage":
            self.start_from_pair()
        self.average = {k: v.detach().clone() for k, v in self.network.state_dict().items()}
        self.optimiser = torch.optim.AdamW(parameter_groups(self.network, settings.weight_decay), lr=settings.learning_rate)
        self.step = 0
        self.seconds = 0.0  # process CPU time spent in training steps, over all sessions
        folder.mkdir(parents=True, exist_ok=True)
        if resume and self.path.exists():
            state = torch.load(self.path, map_location=device, weights_only=True)
            self.network.load_state_dict(state["network"])
            self.average = state["average"]
            self.optimiser.load_state_dict(state["optimiser"])
            self.step, self.seconds = state["step"], state["seconds"]
        keep_coordinates_exact(self.network)
        self.objective = OBJECTIVES[settings.network](SAMPLINGS[settings.sampling], settings.augmented)
        self.clock = Clock(settings.steps)

    def start_from_pair(self) -> None:
        """Fine-tuning begins with the averaged weights of the run that trained the two networks side by side, where it exists."""
        pair = self.folder.with_name(self.folder.name.replace("joint_stage", "joint_pair")) / "checkpoint.pt"
        if pair.exists():
            self.network.load_state_dict(torch.load(pair, map_location=self.device, weights_only=True)["average"])

    @property
    def path(self) -> Path:
        return self.folder / "checkpoint.pt"

    def device_name(self) -> str:
        return torch.cuda.get_device_name(self.device) if torch.device(self.device).type == "cuda" else "cpu"

    def save(self) -> None:
        state = {
            "settings": asdict(self.settings), "step": self.step, "seconds": self.seconds,
            "network": self.network.state_dict(), "average": self.average, "optimiser": self.optimiser.state_dict(),
        }
        temporary = self.path.with_suffix(".tmp")
        torch.save(state, temporary)
        temporary.replace(self.path)
        (self.folder / "status.json").write_text(json.dumps({"step": self.step, "seconds": round(self.seconds, 1)}))

    def train_step(self, pool: Pool) -> float:
        """One step by itself, with its batch made here."""
        return float(self.learn(StepBatches(self.settings, pool, self.objective, self.clock)[self.step]))

    def learn(self, batch: dict) -> torch.Tensor:
        """One step from its batch -> loss, still on the device."""
        settings = self.settings
        torch.manual_seed(settings.seed * 1_000_003 + self.step)  # dropout
        batch = {k: v.to(self.device, non_blocking=True) if torch.is_tensor(v) else v for k, v in batch.items()}
        for group in self.optimiser.param_groups:
            group["lr"] = settings.rate(self.clock.progress(self.step))
        self.network.train()
        with torch.autocast(torch.device(self.device).type, torch.bfloat16, enabled=settings.mixed_precision):
            loss = self.objective.loss(self.network, batch)
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        nn.utils.clip_grad_norm_(self.network.parameters(), settings.gradient_norm_max)
        self.optimiser.step()
        self.step += 1
        self.follow(min(settings.average_decay, (1 + self.step) / (10 + self.step)))
        return loss.detach()

    @torch.no_grad()
    def follow(self, decay: float) -> None:
        """The moving average of the weights takes a step towards them; counters are copied."""
        pairs = [(self.average[name], value) for name, value in self.network.state_dict().items()]
        moving, weights = zip(*(pair for pair in pairs if pair[1].is_floating_point()))
        torch._foreach_lerp_(list(moving), list(weights), 1 - decay)
        for mine, value in pairs:
            if not value.is_floating_point():
                mine.copy_(value)

    def batches(self, pool: Pool, workers: int):
        """Batches from the present step on, made ahead by ``workers`` processes, or here when there are none."""
        source = StepBatches(self.settings, pool, self.objective, self.clock)
        return torch.utils.data.DataLoader(
            source, batch_size=None, sampler=range(self.step, self.settings.steps), num_workers=workers,
            prefetch_factor=4 if workers else None, pin_memory=bool(workers) and torch.device(self.device).type == "cuda")

    def train(self, pool: Pool, minutes: float, workers: int = 0, by_clock: bool = False) -> None:
        """Steps until the schedule or the wall clock ends, or a TERM signal; saves every minute and at the end.

        ``by_clock`` fits the schedule to the minutes, however many steps they hold.
        """
        started = saved = time.monotonic()
        if by_clock:
            self.clock = Clock(self.settings.steps, minutes, started)
        losses: list[torch.Tensor] = []
        stopped: list[int] = []
        signal.signal(signal.SIGTERM, lambda number, _: stopped.append(number))
        before = time.process_time()
        for batch in self.batches(pool, workers):
            losses.append(self.learn(batch))
            self.seconds += time.process_time() - before
            before = time.process_time()
            if self.step % LOG_STEPS == 0:
                self.log(losses)
                losses = []
            if time.monotonic() - saved > CHECKPOINT_SECONDS:
                self.save()
                saved = time.monotonic()
            if time.monotonic() - started > 60 * minutes or stopped:
                break
        if by_clock:
            self.settings.steps = self.step
        self.save()
        write_averages(self.path, self.folder / "averages.pt")

    def log(self, losses: list[torch.Tensor]) -> None:
        rate = self.settings.rate(self.clock.progress(self.step))
        line = {"step": self.step, "loss": round(float(torch.stack(losses).mean()), 5), "rate": round(rate, 7),
                "cpu_minutes": round(self.seconds / 60, 2), "time": time.strftime("%H:%M:%S")}
        with open(self.folder / "log.jsonl", "a") as file:
            file.write(json.dumps(line) + "\n")


def parameter_groups(network: nn.Module, weight_decay: float) -> list[dict]:
    """Weight decay on matrices only, not on biases or normalisation."""
    matrices = [p for p in network.parameters() if p.ndim > 1]
    others = [p for p in network.parameters() if p.ndim <= 1]
    return [{"params": matrices, "weight_decay": weight_decay}, {"params": others, "weight_decay": 0.0}]


def keep_coordinates_exact(network: nn.Module) -> None:
    """Takes the layers that read coordinates, and the last one, out of mixed precision.

    bfloat16 has 8 significant bits: a position near 1 would be rounded to 1/256, a tenth of a fingers' distance.
    """
    for name, module in network.named_modules():
        narrow_edges = isinstance(module, EdgeConv) and module.channels_in <= COORDINATE_CHANNELS_MAX
        narrow_linear = isinstance(module, nn.Linear) and (
            module.in_features <= COORDINATE_CHANNELS_MAX or name.split(".")[-1] == "out")
        if narrow_edges or narrow_linear:
            module.forward = in_full_precision(module.forward)


def in_full_precision(forward):
    def run(*inputs):
        with torch.autocast(inputs[0].device.type, enabled=False):
            return forward(*(x.float() if x.is_floating_point() else x for x in inputs))
    return run


def write_averages(checkpoint: Path, path: Path) -> None:
    """What ``averaged_network`` needs of a checkpoint, in half precision: small enough to travel."""
    state = torch.load(checkpoint, map_location="cpu", weights_only=True)
    average = {name: value.half() if value.is_floating_point() else value for name, value in state["average"].items()}
    torch.save({**{key: state[key] for key in ("settings", "step", "seconds")}, "average": average}, path)


def averaged_network(checkpoint: Path, device: str = "cpu") -> tuple[nn.Module, dict]:
    """The shipped weights of a run (the moving average), in evaluation mode, and the checkpoint's other entries."""
    state = torch.load(checkpoint, map_location=device, weights_only=True)
    settings = Settings(**state["settings"])
    network = TRAINED[settings.network](settings.width, settings.normalisation)
    network.load_state_dict(state["average"])
    return network.eval(), {"settings": settings, "step": state["step"], "seconds": state["seconds"]}
