"""Bone and root networks trained together on one joint graph: the tree helps to find the root, and the other way round."""

from torch import nn

from ..rignet import RigNetBone, RigNetRoot
from ..rignet.joint_graph import JointGraph


class SkeletonStage(nn.Module):
    """Exported as the two networks, each with its copy of the graph."""

    parts = {"bone": "rignet_bone", "root": "rignet_root"}

    def __init__(self, width: float, normalisation: str):
        super().__init__()
        graph = JointGraph(width)
        self.bone = RigNetBone(width, normalisation, graph)
        self.root = RigNetRoot(width, normalisation, graph)

    def forward(self, positions, joints, inside_share, valid):
        """Padded joints -> bone logits (G, J, J), root logits (G, J). Shapes as of JointGraph."""
        codes, pairs, distance = self.bone.graph(positions, joints, inside_share, valid)
        return self.bone.of_codes(codes, pairs, distance), self.root.of_codes(codes, valid)
