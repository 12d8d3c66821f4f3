//! glTF in and out: the file that was sent, plus a skin.

mod existing_rigs;
mod fixtures;
mod kept_skeletons;
mod reading;
mod refusals;
mod rig_files;
mod separate_skeletons;
mod skins;
mod transforms;
mod unchanged;
