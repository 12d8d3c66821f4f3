"""The networks of RigNet as published: their graphs, and the reader of their checkpoint files."""
