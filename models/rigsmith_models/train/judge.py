"""How well a joint run does while it trains: its moving average, from joints found to figures, on characters that are given."""

import numpy as np
import torch

from ..evaluation.clustering import Clustering
from ..evaluation.stages import displaced, joint_stage, point_figures
from .joint_stage import JointStage

FIGURES = ("cd_j2j", "iou", "precision", "recall", "iou_half", "joints")


class Asked:
    """A network in training as a function of its inputs by name, like a shipped file."""

    def __init__(self, network: torch.nn.Module):
        self.network = network.eval()

    def __call__(self, **inputs) -> np.ndarray:
        with torch.no_grad():
            return self.network(*(torch.from_numpy(np.ascontiguousarray(inputs[name])) for name in self.network.inputs)).numpy()


def judged(pair: JointStage, characters, settings: Clustering, reference_mask: bool = False) -> dict[str, float]:
    """Means over the characters; with ``reference_mask`` the true mask speaks in place of the attention."""
    predictions = displaced(characters, Asked(pair.displacement), Asked(pair.attention))
    if reference_mask:
        predictions = [(d, c.attention_mask.astype(np.float32)) for c, (d, _) in zip(characters, predictions)]
    rows = joint_stage(characters, predictions, settings)
    figures = {name: float(np.mean(rows[name])) for name in FIGURES}
    return figures | {name: float(np.mean(values)) for name, values in point_figures(characters, predictions).items()}
