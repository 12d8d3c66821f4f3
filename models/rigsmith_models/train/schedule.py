"""How much training each network gets, and whose turn it is."""

import json
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Plan:
    network: str
    steps: int
    learning_rate: float
    share: float  # of the CPU time, relative to the others
    after: tuple[str, ...] = ()  # networks that must be finished first


# For one core of a CPU: what the shipped files had, for RigNet's skin what is due; the joint networks' own come from a GPU (train_on_gpu.sh).
PLANS = {
    plan.network: plan
    for plan in (
        Plan("rignet_joint_pair", steps=16000, learning_rate=2e-3, share=63.0),
        Plan("rignet_skeleton_stage", steps=4000, learning_rate=2e-3, share=24.0),
        Plan("rignet_skin", steps=3000, learning_rate=1e-3, share=24.0),
        Plan("heter_skin_net", steps=8000, learning_rate=1e-3, share=24.0),
        Plan("rignet_joint_stage", steps=900, learning_rate=2e-4, share=20.0, after=("rignet_joint_pair",)),
    )
}


def status(runs: Path, network: str) -> dict:
    """-> {"step", "seconds"} of a run, zeros before it exists."""
    path = runs / network / "status.json"
    return json.loads(path.read_text()) if path.exists() else {"step": 0, "seconds": 0.0}


def next_due(runs: Path) -> Plan | None:
    """The unfinished network that is farthest behind its share, or None when all are finished."""
    unfinished = [p for p in PLANS.values() if status(runs, p.network)["step"] < p.steps]
    waiting = {p.network for p in unfinished}
    unfinished = [p for p in unfinished if waiting.isdisjoint(p.after)]
    return min(unfinished, key=lambda p: status(runs, p.network)["seconds"] / p.share, default=None)
