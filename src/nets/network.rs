//! One ONNX graph as a pool of sessions: checked tensors in, checked tensors out.

use super::error::NetError;
use super::runtime::Runtime;
use crate::cancellation::Cancellation;
use ndarray::{ArrayD, ArrayViewD};
use ort::session::builder::GraphOptimizationLevel;
use ort::session::{RunOptions, Session, SessionInputValue};
use ort::value::TensorRef;
use std::borrow::Cow;
use std::sync::{Arc, Mutex, PoisonError};

/// A tensor handed to a network, borrowed, in standard (C) layout.
#[derive(Clone)]
pub enum Input<'a> {
    F32(ArrayViewD<'a, f32>),
    I64(ArrayViewD<'a, i64>),
}

/// A loaded graph. A session runs one job at a time, so concurrent jobs take one each from the pool; it never grows
/// beyond the number of concurrent callers.
pub struct Network {
    name: String,
    model: Vec<u8>,
    runtime: Runtime,
    input_names: Vec<String>,
    idle: Mutex<Vec<Session>>,
}

impl Network {
    /// Opens the graph in `model` (the bytes of an ONNX file) and its first session.
    pub fn open(runtime: &Runtime, name: &str, model: Vec<u8>) -> Result<Self, NetError> {
        let mut network = Self {
            name: name.to_owned(),
            model,
            runtime: runtime.clone(),
            input_names: Vec::new(),
            idle: Mutex::default(),
        };
        let first = network.new_session()?;
        network.input_names = first.inputs().iter().map(|input| input.name().to_owned()).collect();
        network.put_back(first);
        Ok(network)
    }

    pub fn name(&self) -> &str {
        &self.name
    }

    /// Names of the graph's inputs, in the graph's order.
    pub fn input_names(&self) -> &[String] {
        &self.input_names
    }

    /// Runs the graph and returns its output `output`, which must be finite.
    ///
    /// A cancellation ends the run at the next graph node.
    pub fn run(
        &self,
        inputs: &[(&str, Input)],
        output: &str,
        cancellation: &Cancellation,
    ) -> Result<ArrayD<f32>, NetError> {
        cancellation.check()?;
        let _span = tracing::debug_span!("network", name = self.name).entered();
        let mut session = self.take()?;
        let result = self.run_session(&mut session, inputs, output, cancellation);
        self.put_back(session);
        let values = match result {
            Err(_) if cancellation.is_cancelled() => return Err(crate::cancellation::Cancelled.into()),
            other => other?,
        };
        if values.iter().all(|value| value.is_finite()) {
            Ok(values)
        } else {
            Err(NetError::NotFinite { network: self.name.clone() })
        }
    }

    fn run_session(
        &self,
        session: &mut Session,
        inputs: &[(&str, Input)],
        output: &str,
        cancellation: &Cancellation,
    ) -> Result<ArrayD<f32>, NetError> {
        let failed = |error: ort::Error| self.failed(&error);
        let mut options = RunOptions::new().map_err(failed)?;
        // Gives the arena's growth back after the run: a large mesh must not hold its peak for ever.
        options.set("memory.enable_memory_arena_shrinkage", "cpu:0").map_err(failed)?;
        let options = Arc::new(options);
        let terminate = Arc::clone(&options);
        let registration = cancellation.on_cancel(move || {
            // A failure here leaves the run to finish by itself; the flag is looked at right after.
            let _ = terminate.terminate();
        });
        let mut values: Vec<(Cow<str>, SessionInputValue)> = Vec::with_capacity(inputs.len());
        for (name, input) in inputs {
            let value: SessionInputValue = match input {
                Input::F32(array) => TensorRef::from_array_view(array.view()).map_err(failed)?.into(),
                Input::I64(array) => TensorRef::from_array_view(array.view()).map_err(failed)?.into(),
            };
            values.push((Cow::Borrowed(*name), value));
        }
        let outputs = session.run_with_options(values, &*options).map_err(failed)?;
        drop(registration);
        let value = outputs.get(output).ok_or_else(|| NetError::Interface {
            network: self.name.clone(),
            what: "output name",
            got: outputs.keys().collect::<Vec<_>>().join(", "),
            expected: output.to_owned(),
        })?;
        Ok(value.try_extract_array::<f32>().map_err(failed)?.to_owned())
    }

    fn take(&self) -> Result<Session, NetError> {
        let idle = self.idle.lock().unwrap_or_else(PoisonError::into_inner).pop();
        idle.map_or_else(|| self.new_session(), Ok)
    }

    fn put_back(&self, session: Session) {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner).push(session);
    }

    fn new_session(&self) -> Result<Session, NetError> {
        let builder = Session::builder(&self.runtime.environment).map_err(|error| self.failed(&error))?;
        let builder = builder
            .with_optimization_level(GraphOptimizationLevel::Level3)
            .map_err(|error| self.failed(&error))?
            .with_deterministic_compute(true)
            .map_err(|error| self.failed(&error))?;
        let mut builder = builder.with_intra_op_spinning(false).map_err(|error| self.failed(&error))?;
        builder.commit_from_memory(&self.model).map_err(|error| self.failed(&error))
    }

    fn failed<R>(&self, error: &ort::Error<R>) -> NetError {
        NetError::Run { network: self.name.clone(), cause: error.to_string() }
    }
}
