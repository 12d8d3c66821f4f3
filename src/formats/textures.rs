//! Texture files of an upload: each read once, kept as bytes, told by their first bytes.

use super::siblings::{self, base_name};
use super::{DecodeError, DecodeOptions, Finding, Image, ImageType, Limits, Severity, Siblings};
use std::collections::HashMap;

/// The images that materials refer to, in order of first use.
pub(super) struct Textures<'a> {
    siblings: &'a dyn Siblings,
    allow_missing: bool,
    images_max: usize,
    images: Vec<Image>,
    index_of: HashMap<String, Option<usize>>,
    findings: Vec<Finding>,
}

impl<'a> Textures<'a> {
    pub(super) fn new(siblings: &'a dyn Siblings, options: &DecodeOptions, limits: &Limits) -> Self {
        Self {
            siblings,
            allow_missing: options.allow_missing_textures,
            images_max: limits.materials_max,
            images: Vec::new(),
            index_of: HashMap::new(),
            findings: Vec::new(),
        }
    }

    /// The image that a file in `folder` calls `name`; `None`, with a finding, when it cannot be carried over.
    pub(super) fn load(&mut self, folder: &str, name: &str) -> Result<Option<usize>, DecodeError> {
        if let Some(&known) = self.index_of.get(name) {
            return Ok(known);
        }
        let index = match siblings::find(self.siblings, folder, name) {
            Some(bytes) => self.add(name, bytes)?,
            None if self.allow_missing => {
                self.findings.push(Finding {
                    code: "missing_texture",
                    parts: Vec::new(),
                    severity: Severity::Warning,
                    message: format!("the texture {name} was not sent; its material stays without it"),
                    hint: format!("send {} along, for example in one zip", base_name(name)),
                });
                None
            }
            None => return Err(DecodeError::MissingResource { name: name.into() }),
        };
        self.index_of.insert(name.into(), index);
        Ok(index)
    }

    /// Takes over an image that is embedded in the file under `name`.
    pub(super) fn embedded(&mut self, name: &str, bytes: &[u8]) -> Result<Option<usize>, DecodeError> {
        if let Some(&known) = self.index_of.get(name) {
            return Ok(known);
        }
        let index = self.add(name, bytes.to_vec())?;
        self.index_of.insert(name.into(), index);
        Ok(index)
    }

    fn add(&mut self, name: &str, bytes: Vec<u8>) -> Result<Option<usize>, DecodeError> {
        let Some(media_type) = ImageType::of(&bytes) else {
            self.findings.push(Finding {
                code: "texture_format",
                parts: Vec::new(),
                severity: Severity::Warning,
                message: format!("the texture {name} is neither PNG nor JPEG and cannot be put into a glTF file"),
                hint: "convert it to PNG".into(),
            });
            return Ok(None);
        };
        let (found, limit) = (self.images.len() as u64 + 1, self.images_max as u64);
        if found > limit {
            return Err(DecodeError::TooMany { what: "textures", found, limit });
        }
        self.images.push(Image { name: base_name(name).to_owned(), media_type, bytes });
        Ok(Some(self.images.len() - 1))
    }

    /// The images, and the findings appended to `findings`.
    pub(super) fn finish(self, mut findings: Vec<Finding>) -> (Vec<Image>, Vec<Finding>) {
        findings.extend(self.findings);
        (self.images, findings)
    }
}
