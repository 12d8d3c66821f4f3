//! What is in force, and where each value comes from.

use super::file::nearest;
use super::{ConfigFile, SECRETS, URLS};
use clap::parser::ValueSource;
use clap::{ArgMatches, Command};
use std::fmt;
use std::path::PathBuf;

/// A setting as it is in force.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Setting {
    pub name: String,
    /// Masked when it is a secret; `None`: unset, which means off.
    pub value: Option<String>,
    pub origin: Origin,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Origin {
    Flag,
    Environment(String),
    File(PathBuf),
    Default,
    Unset,
}

impl fmt::Display for Origin {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Origin::Flag => out.write_str("flag"),
            Origin::Environment(variable) => write!(out, "environment {variable}"),
            Origin::File(path) => write!(out, "file {}", path.display()),
            Origin::Default => out.write_str("default"),
            Origin::Unset => out.write_str("unset"),
        }
    }
}

/// Every setting of `command`, in its order, as `matches` have it; `file` gave some of the defaults.
pub fn effective(command: &Command, matches: &ArgMatches, file: &ConfigFile) -> Vec<Setting> {
    let arguments = command.get_arguments().filter(|argument| argument.get_env().is_some());
    arguments
        .map(|argument| {
            let name = argument.get_id().as_str();
            let raw = matches.get_raw(name).and_then(|mut values| values.next());
            let value = raw.map(|value| value.to_string_lossy().into_owned());
            let origin = match matches.value_source(name) {
                Some(ValueSource::CommandLine) => Origin::Flag,
                Some(ValueSource::EnvVariable) => {
                    Origin::Environment(argument.get_env().unwrap_or_default().to_string_lossy().into_owned())
                }
                Some(_) if file.values.contains_key(name) => Origin::File(file.path.clone()),
                Some(_) => Origin::Default,
                None => Origin::Unset,
            };
            let masked = value.map(|value| match name {
                name if SECRETS.contains(&name) => "***".to_owned(),
                name if URLS.contains(&name) => without_password(&value),
                _ => value,
            });
            Setting { name: name.to_owned(), value: masked, origin }
        })
        .collect()
}

/// A URL whose password, before the host or among the parameters, is masked.
fn without_password(url: &str) -> String {
    let Ok(mut parsed) = reqwest::Url::parse(url) else { return url.to_owned() };
    if parsed.password().is_none() && !parsed.query_pairs().any(|(name, _)| name == "password") {
        return url.to_owned();
    }
    if parsed.password().is_some() {
        // Fails for URLs that cannot have a password.
        let _ = parsed.set_password(Some("***"));
    }
    if let Some(query) = parsed.query() {
        let masked = query.split('&').map(|pair| match pair.split_once('=') {
            Some(("password", _)) => "password=***",
            _ => pair,
        });
        let masked = masked.collect::<Vec<_>>().join("&");
        parsed.set_query(Some(&masked));
    }
    parsed.into()
}

/// The settings as a file that says the same, each with its origin.
pub fn to_toml(settings: &[Setting]) -> String {
    let lines = settings.iter().map(|setting| {
        let name = &setting.name;
        match &setting.value {
            // The file cannot name itself.
            Some(value) if name == "config" => format!("# {name} = {value}"),
            Some(value) if value.parse::<i64>().is_ok() || value.parse::<bool>().is_ok() => format!("{name} = {value}"),
            Some(value) => format!("{name} = {}", toml::Value::String(value.clone())),
            None => format!("# {name}"),
        }
    });
    let lines: Vec<String> = lines.collect();
    let width = lines.iter().map(String::len).max().unwrap_or(0).min(44);
    lines.iter().zip(settings).map(|(line, setting)| format!("{line:<width$}  # {}\n", setting.origin)).collect()
}

/// Variables of the environment that begin like ours and name no setting, each with the nearest that does.
pub fn unknown_variables<'a>(
    names: impl Iterator<Item = String> + 'a,
    known: &'a [&'a str],
) -> impl Iterator<Item = (String, Option<&'a str>)> + 'a {
    let ours = names.filter(|name| name.starts_with("RIGSMITH_") && !known.contains(&name.as_str()));
    ours.map(|name| {
        let near = nearest(&name, known);
        (name, near)
    })
}
