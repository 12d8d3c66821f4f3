//! The models folder opened: networks loaded, digests and known answers checked, method by method.

use super::error::NetError;
use super::heter_skin_net::HeterSkinNet;
use super::locate::{models_candidates, runtime_candidates};
use super::manifest::{Licence, Manifest, NetworkEntry};
use super::network::Network;
use super::rignet::RigNets;
use super::runtime::Runtime;
use super::self_test;
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};

/// Where to look and how many threads to use.
#[derive(Clone, Debug)]
pub struct LoadOptions {
    /// ONNX Runtime's library; `None`: search.
    pub onnxruntime: Option<PathBuf>,
    /// Folder of `manifest.json`; `None`: search.
    pub models: Option<PathBuf>,
    /// Threads of the one pool that all networks share.
    pub threads: usize,
}

/// All networks that this build knows. A method whose networks do not all pass is unavailable, and says why.
pub struct Models {
    rignet: Result<RigNets, String>,
    heter_skin_net: Result<HeterSkinNet, String>,
    statuses: Vec<ModelStatus>,
    licence: Licence,
    folder: PathBuf,
}

/// What became of one network.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ModelStatus {
    pub name: &'static str,
    /// Of the file that was loaded, lower-case hexadecimal; empty when there was none to read.
    pub sha256: String,
    /// Why it is not used.
    pub failure: Option<String>,
}

impl Models {
    /// Loads everything. Fails when there is no runtime or no manifest; a broken network only ends its method.
    pub fn load(options: &LoadOptions) -> Result<Self, NetError> {
        let (manifest, folder) = Manifest::find(&models_candidates(options.models.as_deref()))?;
        let runtime = Runtime::load(&runtime_candidates(options.onnxruntime.as_deref()), options.threads)?;
        let mut statuses = Vec::new();
        let mut open = |name: &'static str| {
            let mut sha256 = String::new();
            let network = open_network(&runtime, &manifest, &folder, name, &mut sha256);
            let failure = network.as_ref().err().map(NetError::to_string);
            statuses.push(ModelStatus { name, sha256, failure });
            network.map_err(|error| error.to_string())
        };
        // All are opened, so that every failure is seen, before the first failure ends the method.
        let [displacement, attention, bone, root, skin] = RigNets::NETWORKS.map(&mut open);
        let rignet = (|| {
            Ok(RigNets { displacement: displacement?, attention: attention?, bone: bone?, root: root?, skin: skin? })
        })();
        let heter_skin_net = open(HeterSkinNet::NETWORK).map(HeterSkinNet);
        Ok(Self { rignet, heter_skin_net, statuses, licence: manifest.licence, folder })
    }

    /// RigNet's networks, or why the method is unavailable.
    pub fn rignet(&self) -> Result<&RigNets, &str> {
        self.rignet.as_ref().map_err(String::as_str)
    }

    /// HeterSkinNet, or why it is unavailable.
    pub fn heter_skin_net(&self) -> Result<&HeterSkinNet, &str> {
        self.heter_skin_net.as_ref().map_err(String::as_str)
    }

    /// Every network, in a fixed order.
    pub fn statuses(&self) -> &[ModelStatus] {
        &self.statuses
    }

    pub fn licence(&self) -> &Licence {
        &self.licence
    }

    /// The folder that they came from.
    pub fn folder(&self) -> &Path {
        &self.folder
    }
}

/// Reads, checks and tests one network; leaves its digest in `sha256` as soon as that is known.
fn open_network(
    runtime: &Runtime,
    manifest: &Manifest,
    folder: &Path,
    name: &'static str,
    sha256: &mut String,
) -> Result<Network, NetError> {
    let entry = manifest.networks.get(name).ok_or(NetError::NotListed { network: name })?;
    let path = folder.join(&entry.file);
    let model = std::fs::read(&path).map_err(|error| NetError::Unreadable { path, cause: error.to_string() })?;
    *sha256 = Sha256::digest(&model).iter().map(|byte| format!("{byte:02x}")).collect();
    if *sha256 != entry.sha256 {
        let (expected, actual) = (entry.sha256.clone(), sha256.clone());
        return Err(NetError::Digest { network: name.to_owned(), expected, actual });
    }
    let network = Network::open(runtime, name, model)?;
    check_interface(&network, entry)?;
    self_test::run(&network, entry)?;
    Ok(network)
}

fn check_interface(network: &Network, entry: &NetworkEntry) -> Result<(), NetError> {
    let got = network.input_names();
    let expected: Vec<String> = entry.inputs.iter().map(|input| input.name.clone()).collect();
    if got == expected {
        return Ok(());
    }
    Err(NetError::Interface {
        network: network.name().to_owned(),
        what: "list of inputs",
        got: got.join(", "),
        expected: expected.join(", "),
    })
}
