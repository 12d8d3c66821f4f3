//! What an upload is, by its headers and names. What it holds is for [`crate::formats`] to find out.

use super::error::{ApiError, Code};
use crate::jobs::ErrorCode;
use axum::http::{HeaderMap, header};

/// How a body is to be read.
#[derive(Debug, PartialEq, Eq)]
pub enum Body {
    /// The mesh itself.
    Mesh {
        name: String,
    },
    Form,
    /// The options, with the name of an asset.
    Json,
}

/// Media types of meshes, and the extension that stands for each. No extension: the content decides.
const MESHES: &[(&str, &str)] = &[
    ("model/gltf-binary", "glb"),
    ("model/gltf+json", "gltf"),
    ("model/obj", "obj"),
    ("model/stl", "stl"),
    ("model/x.stl-binary", "stl"),
    ("model/x.stl-ascii", "stl"),
    ("application/sla", "stl"),
    ("model/ply", "ply"),
    ("application/x-ply", "ply"),
    ("model/fbx", "fbx"),
    ("application/vnd.autodesk.fbx", "fbx"),
    ("application/zip", "zip"),
    ("application/x-zip-compressed", "zip"),
    ("application/octet-stream", ""),
    ("binary/octet-stream", ""),
    // What curl says of --data-binary when it is told nothing.
    ("application/x-www-form-urlencoded", ""),
];
const MESH_EXTENSIONS: &[&str] = &["glb", "gltf", "obj", "ply", "stl", "fbx", "zip"];
const NAME_BYTES_MAX: usize = 240;

/// Decides by `Content-Type` how the body is read; `file_name` names a raw body. JSON is read where it can say
/// something, which is where an asset may be named.
pub fn body(headers: &HeaderMap, file_name: Option<String>, json: bool) -> Result<Body, ApiError> {
    let declared = headers.get(header::CONTENT_TYPE).map(|value| value.to_str().unwrap_or("not ASCII"));
    let essence = declared.unwrap_or("application/octet-stream").split(';').next().unwrap_or_default();
    let essence = essence.trim().to_ascii_lowercase();
    if essence == "multipart/form-data" {
        if file_name.is_some() {
            return Err(ApiError::field("file_name", "is for a raw body; in a form, the file has its name with it"));
        }
        return Ok(Body::Form);
    }
    if essence == "application/json" && json {
        if file_name.is_some() {
            return Err(ApiError::field("file_name", "is for a raw body; an asset has its name already"));
        }
        return Ok(Body::Json);
    }
    let name = match file_name {
        Some(name) => name_for(&essence).map(|_| name)?,
        None => name_for(&essence)?,
    };
    Ok(Body::Mesh { name })
}

/// A name for a mesh of this media type; without an extension when the type leaves the choice.
pub fn name_for(essence: &str) -> Result<String, ApiError> {
    match MESHES.iter().find(|(name, _)| *name == essence) {
        Some((_, "")) => Ok("upload".to_owned()),
        Some((_, extension)) => Ok(format!("upload.{extension}")),
        None => Err(unsupported(essence)),
    }
}

fn unsupported(seen: &str) -> ApiError {
    let seen: String = seen.chars().take(80).collect();
    let error = ApiError::new(
        Code::Work(ErrorCode::UnsupportedMediaType),
        format!("the body is declared as {seen:?}, which is no mesh format that is read here"),
    );
    error.hint(
        "send the mesh as model/gltf-binary, model/gltf+json, model/obj, model/ply, model/stl, model/fbx, \
         application/zip or multipart/form-data; application/octet-stream lets the content decide",
    )
}

/// Whether the extension is that of a mesh format.
pub fn is_mesh_name(name: &str) -> bool {
    let extension = name.rsplit_once('.').map(|(_, extension)| extension.to_ascii_lowercase());
    extension.is_some_and(|extension| MESH_EXTENSIONS.contains(&extension.as_str()))
}

/// A file name as it came in, with `/` between folders; refused when it leaves the upload.
pub fn relative_name(name: &str) -> Result<String, String> {
    let name = name.trim().replace('\\', "/");
    let shown = || name.chars().take(60).collect::<String>();
    if name.is_empty() || name.len() > NAME_BYTES_MAX {
        return Err(format!("a file name must have 1 to {NAME_BYTES_MAX} bytes"));
    }
    if name.chars().any(char::is_control) {
        return Err(format!("the file name {:?} has control characters", shown()));
    }
    let parts: Vec<&str> = name.split('/').filter(|part| *part != ".").collect();
    let absolute = name.starts_with('/') || parts.first().is_some_and(|part| part.ends_with(':'));
    if absolute || parts.iter().any(|part| part.is_empty() || *part == "..") {
        return Err(format!("the file name {:?} must be relative and stay within the upload", shown()));
    }
    Ok(parts.join("/"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_stay_within_the_upload() {
        assert_eq!(relative_name("./textures\\skin.png").as_deref(), Ok("textures/skin.png"));
        for name in ["", "/etc/passwd", "../a", "a/../../b", "C:/a", "a//b", "a\nb", "a/"] {
            assert!(relative_name(name).is_err(), "{name:?}");
        }
    }

    #[test]
    fn mesh_names_are_known_by_extension() {
        assert!(is_mesh_name("a/Hero.GLB") && !is_mesh_name("hero.png") && !is_mesh_name("glb"));
    }
}
