//! Trained networks as typed functions. The only place that names `ort`.
