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

from ..data.sampling import Pool
from ..layers import EdgeConv
from ..networks import NETWORKS
from .joint_stage import JointStage
from .objectives import OBJECTIVES
from .skeleton_stage import SkeletonStage

STAGES = {"rignet_joint_stage": JointStage, "rignet_skeleton_stage": SkeletonStage}
# What is trained by itself: every network but those that only a stage trains, and the stages.
TRAINED = {**{name: network for name, network in NETWORKS.items() if name not in SkeletonStage.parts.values()}, **STAGES}

CHECKPOINT_SECONDS = 60.0
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

    def rate(self, step: int) -> float:
        progress = step / max(self.steps, 1)
        if progress < self.warm_up:
            return self.learning_rate * (step + 1) / (self.warm_up * self.steps + 1)
        if progress < self.decay_from:
            return self.learning_rate
        fall = 0.5 * (1 + math.cos(math.pi * min((progress - self.decay_from) / (1 - self.decay_from), 1.0)))
        return self.learning_rate * (0.01 + 0.99 * fall)


class Run:
    """The state of one network in training, kept in ``folder``: checkpoint.pt and log.jsonl."""

    def __init__(self, folder: Path, settings: Settings, device: str, resume: bool):
        self.folder, self.settings, self.device = folder, settings, device
        torch.manual_seed(settings.seed)
        self.network = TRAINED[settings.network](settings.width, settings.normalisation).to(device)
        if settings.network == "rignet_joint_stage":
            self.start_from_parts()
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
        self.objective = OBJECTIVES[settings.network]()

    def start_from_parts(self) -> None:
        """Fine-tuning begins with the averaged weights of the two networks, where their runs exist."""
        for part, name in JointStage.parts.items():
            checkpoint = self.folder.parent / name / "checkpoint.pt"
            if checkpoint.exists():
                state = torch.load(checkpoint, map_location=self.device, weights_only=True)
                getattr(self.network, part).load_state_dict(state["average"])

    @property
    def path(self) -> Path:
        return self.folder / "checkpoint.pt"

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
        settings = self.settings
        rng = np.random.default_rng([settings.seed, self.step])
        torch.manual_seed(settings.seed * 1_000_003 + self.step)  # dropout
        progress = self.step / settings.steps
        characters = pool.draw(settings.characters_per_step, progress, rng, settings.real_share)
        batch = self.objective.batch(characters, progress, rng, self.device)
        for group in self.optimiser.param_groups:
            group["lr"] = settings.rate(self.step)
        self.network.train()
        with torch.autocast(torch.device(self.device).type, torch.bfloat16, enabled=settings.mixed_precision):
            loss = self.objective.loss(self.network, batch)
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        nn.utils.clip_grad_norm_(self.network.parameters(), settings.gradient_norm_max)
        self.optimiser.step()
        self.step += 1
        decay = min(settings.average_decay, (1 + self.step) / (10 + self.step))
        with torch.no_grad():
            for name, value in self.network.state_dict().items():
                if value.is_floating_point():
                    self.average[name].lerp_(value, 1 - decay)
                else:
                    self.average[name].copy_(value)
        return float(loss.detach())

    def train(self, pool: Pool, minutes: float) -> None:
        """Steps until the schedule or the wall clock ends, or a TERM signal; saves every minute and at the end."""
        started = saved = time.monotonic()
        losses: list[float] = []
        stopped: list[int] = []
        signal.signal(signal.SIGTERM, lambda number, _: stopped.append(number))
        while self.step < self.settings.steps and time.monotonic() - started < 60 * minutes and not stopped:
            before = time.process_time()
            losses.append(self.train_step(pool))
            self.seconds += time.process_time() - before
            if self.step % LOG_STEPS == 0:
                self.log(losses)
                losses = []
            if time.monotonic() - saved > CHECKPOINT_SECONDS:
                self.save()
                saved = time.monotonic()
        self.save()

    def log(self, losses: list[float]) -> None:
        line = {"step": self.step, "loss": round(float(np.mean(losses)), 5), "rate": round(self.settings.rate(self.step), 7),
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


def averaged_network(checkpoint: Path, device: str = "cpu") -> tuple[nn.Module, dict]:
    """The shipped weights of a run (the moving average), in evaluation mode, and the checkpoint's other entries."""
    state = torch.load(checkpoint, map_location=device, weights_only=True)
    settings = Settings(**state["settings"])
    network = TRAINED[settings.network](settings.width, settings.normalisation)
    network.load_state_dict(state["average"])
    return network.eval(), {"settings": settings, "step": state["step"], "seconds": state["seconds"]}
