from .dense import Dense, normalisation_layer, perceptron
from .edge_convolution import EdgeConv, GMEdgeConv
from .pooling import add_to_graph, maximum_per_graph
from .shape_tokens import ShapeTokens

__all__ = ["Dense", "EdgeConv", "GMEdgeConv", "ShapeTokens", "add_to_graph", "maximum_per_graph", "normalisation_layer", "perceptron"]
