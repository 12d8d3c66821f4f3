"""Training and export of Rigsmith's networks. See ``models/TRAINING.md`` for what is trained on what."""
