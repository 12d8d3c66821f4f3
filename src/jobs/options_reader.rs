//! Reads options field by field, from text and from JSON. One reader serves the command line, query parameters, form
//! fields and JSON, so a field has one name, one range and one message everywhere.

use super::joint_pattern::{PATTERN_LENGTH_MAX, PATTERNS_MAX};
use super::options::{ExistingRigPolicy, GivenSkeleton, Output, RigOptions, Words, axis_name};
use crate::formats::Axis;
use crate::formats::rig_json;
use crate::pipelines::LevelOfDetail;
use serde_json::Value;
use std::fmt;
use std::ops::RangeInclusive;
use std::sync::Arc;

const DETAIL: RangeInclusive<f64> = 0.0..=1.0;
/// In units of the normalised frame (longest side 1). The published RigNet uses 0.03 to 0.062.
const BANDWIDTH: RangeInclusive<f64> = 0.005..=0.5;
const MAX_INFLUENCES: RangeInclusive<u64> = 1..=8;
const SMOOTH: RangeInclusive<f64> = 0.0..=1.0;
/// More than half of a vertex would leave its heaviest joint alone, which `max_influences` 1 says better.
const PRUNE: RangeInclusive<f64> = 0.0..=0.5;

/// Why one field was refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{field}: {detail}")]
pub struct FieldError {
    pub field: String,
    pub problem: FieldProblem,
    /// What was seen and what is accepted.
    pub detail: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FieldProblem {
    Unknown,
    Invalid,
}

/// One value as it came in: text (command line, query, form) or JSON.
#[derive(Clone, Copy, Debug)]
enum Raw<'a> {
    Text(&'a str),
    Json(&'a Value),
}

impl fmt::Display for Raw<'_> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = match self {
            Raw::Text(text) => format!("{text:?}"),
            Raw::Json(value) => value.to_string(),
        };
        if text.chars().count() > SHOWN_CHARACTERS_MAX {
            write!(out, "{}…", text.chars().take(SHOWN_CHARACTERS_MAX).collect::<String>())
        } else {
            out.write_str(&text)
        }
    }
}

/// A refused value is repeated in the message up to this length.
const SHOWN_CHARACTERS_MAX: usize = 60;
/// Refusals collected in one answer; a caller who sends nonsense learns enough from these.
const ERRORS_MAX: usize = 20;

/// Collects fields from any number of places, then gives the options or every refusal at once.
#[derive(Clone, Debug, Default)]
pub struct OptionsReader {
    options: RigOptions,
    seen: Vec<&'static str>,
    errors: Vec<FieldError>,
}

impl OptionsReader {
    /// The names of all fields.
    pub const FIELDS: &'static [&'static str] = &[
        "method",
        "detail",
        "bandwidth",
        "symmetry",
        "fingers",
        "skin_method",
        "boxes",
        "skin_fallback",
        "skeleton",
        "non_deforming",
        "locked_joints",
        "max_influences",
        "smooth",
        "prune",
        "mirror_weights",
        "seed",
        "up",
        "front",
        "existing_rig",
        "outputs",
    ];

    /// Takes a field given as text.
    pub fn text(&mut self, field: &str, value: &str) {
        self.take(field, Raw::Text(value));
    }

    /// Takes a field given as JSON; `null` means the default.
    pub fn json(&mut self, field: &str, value: &Value) {
        self.take(field, Raw::Json(value));
    }

    /// The options, or every field that was refused.
    pub fn finish(mut self) -> Result<RigOptions, Vec<FieldError>> {
        if self.seen.contains(&"detail") && self.seen.contains(&"bandwidth") {
            self.refuse("bandwidth", FieldProblem::Invalid, "give detail or bandwidth, not both".to_owned());
        }
        if let (Some(up), Some(front)) = (self.options.up, self.options.front)
            && line(up) == line(front)
        {
            let detail = format!("{} and up {} lie on one line", axis_name(Some(front)), axis_name(Some(up)));
            self.refuse("front", FieldProblem::Invalid, detail);
        }
        if self.options.skeleton.is_some() && self.options.existing_rig == ExistingRigPolicy::Reskin {
            let detail = "keeps the skeleton of the file; leave skeleton out, or replace the one of the file";
            self.refuse("existing_rig", FieldProblem::Invalid, format!("reskin {detail}"));
        }
        if self.options.locked_joints.is_empty()
            && let Some(given) = self.options.skeleton.as_mut().filter(|given| !given.rows.is_empty())
        {
            // Weights that nobody keeps decide nothing.
            *given = Arc::new(GivenSkeleton { rows: Vec::new(), ..given.as_ref().clone() });
        }
        if self.errors.is_empty() { Ok(self.options) } else { Err(self.errors) }
    }

    fn refuse(&mut self, field: &str, problem: FieldProblem, detail: String) {
        if self.errors.len() < ERRORS_MAX {
            let field = field.chars().take(SHOWN_CHARACTERS_MAX).collect();
            self.errors.push(FieldError { field, problem, detail });
        }
    }

    fn take(&mut self, field: &str, raw: Raw) {
        let Some(known) = Self::FIELDS.iter().find(|known| **known == field) else {
            let detail = format!("no such field; there are {}", Self::FIELDS.join(", "));
            return self.refuse(field, FieldProblem::Unknown, detail);
        };
        if matches!(raw, Raw::Json(Value::Null)) {
            return;
        }
        if self.seen.contains(known) {
            return self.refuse(field, FieldProblem::Invalid, "given twice; send it once".to_owned());
        }
        self.seen.push(known);
        if let Err(detail) = self.set(known, raw) {
            self.refuse(field, FieldProblem::Invalid, detail);
        }
    }

    fn set(&mut self, field: &str, raw: Raw) -> Result<(), String> {
        let options = &mut self.options;
        match field {
            "method" => options.method = method(raw)?,
            "detail" => options.level_of_detail = LevelOfDetail::Detail(number(raw, DETAIL)?),
            "bandwidth" => options.level_of_detail = LevelOfDetail::Bandwidth(number(raw, BANDWIDTH)?),
            "symmetry" => options.symmetry = word(raw)?,
            "fingers" => options.fingers = word(raw)?,
            "skin_method" => options.skin_method = word(raw)?,
            "boxes" => options.boxes = word(raw)?,
            "skin_fallback" => options.skin_fallback = listed(raw)?,
            "skeleton" => options.skeleton = Some(skeleton(raw)?),
            "non_deforming" => options.non_deforming = patterns(raw)?,
            "locked_joints" => options.locked_joints = patterns(raw)?,
            "max_influences" => options.max_influences = whole(raw, MAX_INFLUENCES)? as usize,
            "smooth" => options.smooth = number(raw, SMOOTH)?,
            "prune" => options.prune = number(raw, PRUNE)?,
            "mirror_weights" => options.mirror_weights = word(raw)?,
            "seed" => options.seed = whole(raw, 0..=u64::MAX)?,
            "up" => options.up = axis(raw)?,
            "front" => options.front = axis(raw)?,
            "existing_rig" => options.existing_rig = word(raw)?,
            "outputs" => {
                options.outputs = listed(raw)?;
                if options.outputs.is_empty() {
                    return Err(format!("is empty; name some of {}", Output::choices()));
                }
            }
            _ => return Err("known, but nobody reads it".to_owned()),
        }
        Ok(())
    }
}

/// Which of the three lines an axis lies on.
fn line(axis: Axis) -> u8 {
    match axis {
        Axis::PosX | Axis::NegX => 0,
        Axis::PosY | Axis::NegY => 1,
        Axis::PosZ | Axis::NegZ => 2,
    }
}

fn text(raw: Raw<'_>) -> Result<&str, String> {
    match raw {
        Raw::Text(text) => Ok(text.trim()),
        Raw::Json(Value::String(text)) => Ok(text),
        Raw::Json(other) => Err(format!("{} is not a string", Raw::Json(other))),
    }
}

fn number(raw: Raw, range: RangeInclusive<f64>) -> Result<f64, String> {
    let value = match raw {
        Raw::Text(text) => text.trim().parse().ok(),
        Raw::Json(value) => value.as_f64(),
    };
    let value = value.ok_or_else(|| format!("{raw} is not a number"))?;
    if range.contains(&value) {
        Ok(value)
    } else {
        Err(format!("{raw} is outside {} to {}", range.start(), range.end()))
    }
}

fn whole(raw: Raw, range: RangeInclusive<u64>) -> Result<u64, String> {
    let value = match raw {
        Raw::Text(text) => text.trim().parse().ok(),
        Raw::Json(value) => value.as_u64(),
    };
    value
        .filter(|value| range.contains(value))
        .ok_or_else(|| format!("{raw} is not a whole number from {} to {}", range.start(), range.end()))
}

fn word<W: Words>(raw: Raw) -> Result<W, String> {
    W::parse(text(raw)?).ok_or_else(|| format!("{raw} is not one of {}", W::choices()))
}

fn skeleton(raw: Raw) -> Result<Arc<GivenSkeleton>, String> {
    let read = match raw {
        Raw::Text(text) => rig_json::read(text.as_bytes()),
        Raw::Json(Value::String(text)) => rig_json::read(text.as_bytes()),
        Raw::Json(value) => rig_json::read(value.to_string().as_bytes()),
    };
    read.map(|file| Arc::new(file.into())).map_err(|error| format!("{error}; {}", error.hint()))
}

/// Names of joints, or patterns of names.
fn patterns(raw: Raw) -> Result<Vec<String>, String> {
    let names = texts(raw)?;
    if names.len() > PATTERNS_MAX {
        return Err(format!("{} names are more than {PATTERNS_MAX}; a pattern such as IK_* names many", names.len()));
    }
    match names.iter().find(|name| !(1..=PATTERN_LENGTH_MAX).contains(&name.len())) {
        Some(name) => Err(format!("{} is no name of 1 to {PATTERN_LENGTH_MAX} bytes", Raw::Text(name))),
        None => Ok(names.into_iter().map(str::to_owned).collect()),
    }
}

/// A list of texts; in text separated by commas.
fn texts(raw: Raw<'_>) -> Result<Vec<&str>, String> {
    match raw {
        Raw::Text(text) => Ok(text.split(',').map(str::trim).filter(|name| !name.is_empty()).collect()),
        Raw::Json(Value::Array(values)) => values.iter().map(|value| text(Raw::Json(value))).collect(),
        Raw::Json(_) => Err(format!("{raw} is not a list")),
    }
}

/// A list of words, each once.
fn listed<W: Words>(raw: Raw) -> Result<Vec<W>, String> {
    let mut words = Vec::new();
    for name in texts(raw)? {
        let word = word::<W>(Raw::Text(name))?;
        if !words.contains(&word) {
            words.push(word);
        }
    }
    Ok(words)
}

fn method(raw: Raw) -> Result<Option<String>, String> {
    match text(raw)? {
        "auto" => Ok(None),
        "" => Err("is empty; leave it out, or name a method".to_owned()),
        name => Ok(Some(name.chars().take(SHOWN_CHARACTERS_MAX).collect())),
    }
}

fn axis(raw: Raw) -> Result<Option<Axis>, String> {
    let name = text(raw)?;
    if name == "auto" {
        return Ok(None);
    }
    // In a query string `+` means a blank, so a bare letter is the positive axis.
    let signed = if name.starts_with(['+', '-']) { name.to_owned() } else { format!("+{name}") };
    Axis::ALL
        .into_iter()
        .find(|axis| axis.name() == signed)
        .map(Some)
        .ok_or_else(|| format!("{raw} is not one of auto, x, -x, y, -y, z, -z"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::options::{Boxes, Fingers};
    use crate::pipelines::{SkinMethod, Symmetry};
    use crate::rig::Influence;
    use serde_json::json;

    fn refused(field: &str, value: Value) -> FieldError {
        let mut reader = OptionsReader::default();
        reader.json(field, &value);
        reader.finish().expect_err("refused").remove(0)
    }

    #[test]
    fn a_skeleton_in_json_is_an_object_or_the_text_of_one() {
        let joints = json!([{ "name": "hips", "parent": null, "position": [0.5, 1.0, -0.25] }]);
        let file = json!({ "format": rig_json::FORMAT, "joints": joints });
        let read = |value: Value| {
            let mut reader = OptionsReader::default();
            reader.json("skeleton", &value);
            reader.finish().expect("valid").skeleton.expect("a skeleton")
        };
        assert_eq!(read(json!(file.to_string())), read(file));
        let long = refused("skeleton", json!("x".repeat(1 << 20)));
        assert!(long.detail.len() < 1000, "a refusal does not repeat the file: {} bytes", long.detail.len());
        let long = refused("skeleton", json!({ "format": rig_json::FORMAT, "joints": "x".repeat(1 << 20) }));
        assert!(long.detail.len() < 1000, "a refusal does not repeat the file: {} bytes", long.detail.len());
    }

    #[test]
    fn every_field_is_read_from_text_and_from_json() {
        let joints = json!([{ "name": "hips", "parent": null, "position": [0.5, 1.0, -0.25] }]);
        let skins = json!([{ "joints": [[0]], "weights": [[1.0]] }]);
        let file = json!({ "format": rig_json::FORMAT, "joints": joints, "skins": skins });
        let fields = [
            ("method", "rignet", json!("rignet")),
            ("detail", "0.75", json!(0.75)),
            ("symmetry", "off", json!("off")),
            ("fingers", "on", json!("on")),
            ("skin_method", "geodesic_voxel", json!("geodesic_voxel")),
            ("boxes", "off", json!("off")),
            ("skin_fallback", "geodesic_heat,rignet", json!(["geodesic_heat", "rignet"])),
            ("skeleton", &file.to_string(), file.clone()),
            ("non_deforming", "IK_*, pole", json!(["IK_*", "pole"])),
            ("locked_joints", "head", json!(["head"])),
            ("max_influences", "8", json!(8)),
            ("smooth", "0.25", json!(0.25)),
            ("prune", "0.02", json!(0.02)),
            ("mirror_weights", "auto", json!("auto")),
            ("seed", "18446744073709551615", json!(u64::MAX)),
            ("up", "z", json!("+z")),
            ("front", "-y", json!("-y")),
            ("existing_rig", "replace", json!("replace")),
            ("outputs", "rig_json, glb,glb", json!(["rig_json", "glb"])),
        ];
        let (mut from_text, mut from_json) = (OptionsReader::default(), OptionsReader::default());
        for (field, text, json) in &fields {
            from_text.text(field, text);
            from_json.json(field, json);
        }
        let expected = RigOptions {
            method: Some("rignet".to_owned()),
            level_of_detail: LevelOfDetail::Detail(0.75),
            symmetry: Symmetry::Off,
            fingers: Fingers::On,
            skin_method: Some(SkinMethod::GeodesicVoxel),
            boxes: Boxes::Off,
            skin_fallback: vec![SkinMethod::GeodesicHeat, SkinMethod::RigNet],
            skeleton: Some(Arc::new(GivenSkeleton {
                skeleton: rig_json::read(file.to_string().as_bytes()).expect("reads").skeleton,
                nodes: None,
                rows: vec![vec![Influence { joint: 0, weight: 1.0 }]],
            })),
            non_deforming: vec!["IK_*".to_owned(), "pole".to_owned()],
            locked_joints: vec!["head".to_owned()],
            max_influences: 8,
            smooth: 0.25,
            prune: 0.02,
            mirror_weights: Symmetry::Auto,
            seed: u64::MAX,
            up: Some(Axis::PosZ),
            front: Some(Axis::NegY),
            existing_rig: ExistingRigPolicy::Replace,
            outputs: vec![Output::RigJson, Output::Glb],
        };
        assert_eq!(from_text.finish(), Ok(expected.clone()));
        assert_eq!(from_json.finish(), Ok(expected.clone()));
        let bandwidth = RigOptions { level_of_detail: LevelOfDetail::Bandwidth(0.05), ..RigOptions::default() };
        for options in [expected, bandwidth, RigOptions::default()] {
            let written = options.to_json();
            let mut reader = OptionsReader::default();
            let fields = written.as_object().expect("an object");
            assert_eq!(fields.keys().collect::<Vec<_>>(), OptionsReader::FIELDS.iter().collect::<Vec<_>>());
            fields.iter().for_each(|(field, value)| reader.json(field, value));
            assert_eq!(reader.finish(), Ok(options), "what is written is read back");
        }
    }

    #[test]
    fn every_listed_field_has_a_reader() {
        for field in OptionsReader::FIELDS {
            let error = refused(field, json!({}));
            assert!(!error.detail.contains("nobody"), "{error}");
        }
    }

    #[test]
    fn refusals_name_the_field_what_was_seen_and_what_is_accepted() {
        for (field, value, said) in [
            ("detail", json!(1.5), "1.5 is outside 0 to 1"),
            ("detail", json!("0.5"), "\"0.5\" is not a number"),
            ("bandwidth", json!(0), "0 is outside 0.005 to 0.5"),
            ("max_influences", json!(4.5), "4.5 is not a whole number from 1 to 8"),
            ("smooth", json!(2), "2 is outside 0 to 1"),
            ("prune", json!(0.6), "0.6 is outside 0 to 0.5"),
            ("mirror_weights", json!("yes"), "\"yes\" is not one of auto, on, off"),
            ("seed", json!(-1), "-1 is not a whole number"),
            ("symmetry", json!("maybe"), "\"maybe\" is not one of auto, on, off"),
            (
                "skin_method",
                json!("heat"),
                "\"heat\" is not one of auto, rignet, heter_skin_net, geodesic_voxel, geodesic_heat",
            ),
            ("skeleton", json!({ "format": "rigsmith.rig/1", "joints": [] }), "no joints"),
            ("skin_fallback", json!(["heat"]), "\"heat\" is not one of rignet"),
            ("non_deforming", json!("IK_*"), "is not a list"),
            ("non_deforming", json!([""]), "is no name"),
            ("locked_joints", json!(vec!["a"; 101]), "101 names are more than 100"),
            ("outputs", json!([]), "is empty"),
            ("outputs", json!("glb"), "is not a list"),
            ("colour", json!("red"), "no such field"),
        ] {
            let error = refused(field, value);
            assert_eq!(error.field, field);
            assert!(error.detail.contains(said), "{error}");
        }
        let mut reader = OptionsReader::default();
        reader.text("detail", "NaN");
        assert!(reader.finish().is_err(), "NaN lies in no range");
    }

    #[test]
    fn contradictions_are_refused() {
        let file = r#"{"format": "rigsmith.rig/1", "joints": [{"name": "a", "parent": null, "position": [0, 0, 0]}]}"#;
        for pair in [
            [("detail", "0.5"), ("bandwidth", "0.05")],
            [("up", "y"), ("front", "-y")],
            [("seed", "1"), ("seed", "1")],
            [("skeleton", file), ("existing_rig", "reskin")],
        ] {
            let mut reader = OptionsReader::default();
            for (field, value) in pair {
                reader.text(field, value);
            }
            assert_eq!(reader.finish().expect_err("refused").len(), 1, "{pair:?}");
        }
    }
}
