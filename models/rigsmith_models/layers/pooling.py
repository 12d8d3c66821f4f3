"""Global features. A batch is several characters of equal vertex count, stacked along the first axis."""

import torch


def maximum_per_graph(x: torch.Tensor, graph_count: int) -> torch.Tensor:
    """x: (G*N, C) -> (G, C), the elementwise maximum over the N rows of each of the G graphs."""
    return x.reshape(graph_count, -1, x.shape[1]).amax(1)


def add_to_graph(like: torch.Tensor, x: torch.Tensor) -> torch.Tensor:
    """like: (G*N, C), x: (G, C) -> every row of a graph plus the row of its graph, (G*N, C)."""
    graph_count, channels = x.shape
    return (like.reshape(graph_count, -1, channels) + x.unsqueeze(1)).reshape(-1, channels)
