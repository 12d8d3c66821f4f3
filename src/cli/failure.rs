//! Why a command ended without its result: a line for people, and the exit status for scripts.

use rigsmith::jobs::{ErrorCode, JobError};
use std::path::Path;
use std::process::ExitCode;

/// Message, next step and exit status.
#[derive(Debug)]
pub struct Failure {
    message: String,
    hint: String,
    exit: u8,
}

const BAD_ARGUMENTS: u8 = 2;
const REFUSED: u8 = 3;
const INTERNAL: u8 = 5;

impl Failure {
    pub fn arguments(message: impl Into<String>) -> Self {
        Self { message: message.into(), hint: "see rigsmith --help".into(), exit: BAD_ARGUMENTS }
    }

    pub fn internal(message: impl Into<String>, hint: impl Into<String>) -> Self {
        Self { message: message.into(), hint: hint.into(), exit: INTERNAL }
    }

    /// A file of the user's that cannot be read.
    pub fn unreadable(path: &Path, error: &std::io::Error) -> Self {
        Self { message: format!("{}: {error}", path.display()), hint: String::new(), exit: BAD_ARGUMENTS }
    }

    /// A result that cannot be written.
    pub fn unwritable(path: &Path, error: &std::io::Error) -> Self {
        Self::arguments(format!("{} cannot be written: {error}", path.display())).hint("name another place for it")
    }

    /// The same with another next step.
    pub fn hint(self, hint: impl Into<String>) -> Self {
        Self { hint: hint.into(), ..self }
    }

    /// The work on the file named `input` failed.
    pub fn job(input: &Path, error: &JobError) -> Self {
        let code = error.code.name();
        Self {
            message: format!("{}: {} ({code})", input.display(), error.message),
            hint: error.hint.clone(),
            exit: error.code.exit_code(),
        }
    }

    /// What a service said, in its own code.
    pub fn coded(code: &str, message: &str, hint: &str) -> Self {
        let exit = ErrorCode::named(code).map_or(BAD_ARGUMENTS, ErrorCode::exit_code);
        Self { message: format!("{message} ({code})"), hint: hint.to_owned(), exit }
    }

    /// A problem as a service describes it (RFC 9457).
    pub fn problem(problem: &serde_json::Value) -> Self {
        let text = |name: &str| problem[name].as_str().unwrap_or_default();
        Self::coded(text("code"), text("detail"), text("hint"))
    }

    /// Files that are refused.
    pub fn refused(message: impl Into<String>, hint: impl Into<String>) -> Self {
        Self { message: message.into(), hint: hint.into(), exit: REFUSED }
    }

    /// Says it on stderr.
    pub fn report(&self) -> ExitCode {
        eprintln!("error: {}", self.message);
        if !self.hint.is_empty() {
            eprintln!("  hint: {}", self.hint);
        }
        ExitCode::from(self.exit)
    }
}

impl From<rigsmith::nets::NetError> for Failure {
    fn from(error: rigsmith::nets::NetError) -> Self {
        Self::internal(error.to_string(), error.hint())
    }
}
