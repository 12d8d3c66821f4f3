//! NumPy `.npz` archives of plain arrays: the bridge to the training code, and how golden vectors are read.
//!
//! Trusted input only (our own training data): sizes are bounded by the bytes given, but nothing else is.

use npyz::WriterBuilder;
use std::collections::BTreeMap;
use std::io::{Cursor, Read, Write};
use zip::write::SimpleFileOptions;

/// Named arrays, sorted by name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Arrays(pub BTreeMap<String, Array>);

/// An array in C order.
#[derive(Clone, Debug, PartialEq)]
pub struct Array {
    pub shape: Vec<usize>,
    pub values: Values,
}

/// What is in an array. Smaller number types come as the wider one of their kind.
#[derive(Clone, Debug, PartialEq)]
pub enum Values {
    F32(Vec<f32>),
    F64(Vec<f64>),
    I32(Vec<i32>),
    I64(Vec<i64>),
    U8(Vec<u8>),
}

/// Why an archive was not read.
#[derive(Debug, thiserror::Error)]
pub enum NpzError {
    #[error("not an .npz archive: {0}")]
    Archive(String),
    #[error("array {name}: {cause}")]
    Array { name: String, cause: String },
    #[error("the archive has no array {0}")]
    Missing(String),
}

impl Arrays {
    /// Reads every numeric array; text arrays (joint names) are left out.
    pub fn read(bytes: &[u8]) -> Result<Self, NpzError> {
        let mut archive = zip::ZipArchive::new(Cursor::new(bytes)).map_err(|e| NpzError::Archive(e.to_string()))?;
        let mut arrays = BTreeMap::new();
        for index in 0..archive.len() {
            let mut entry = archive.by_index(index).map_err(|e| NpzError::Archive(e.to_string()))?;
            let name = entry.name().trim_end_matches(".npy").to_owned();
            let mut npy = Vec::new();
            entry.read_to_end(&mut npy).map_err(|e| NpzError::Archive(e.to_string()))?;
            if let Some(array) = read_array(&npy).map_err(|cause| NpzError::Array { name: name.clone(), cause })? {
                arrays.insert(name, array);
            }
        }
        Ok(Self(arrays))
    }

    /// Writes a compressed archive; equal arrays give equal bytes.
    pub fn write(&self) -> Result<Vec<u8>, NpzError> {
        let mut archive = zip::ZipWriter::new(Cursor::new(Vec::new()));
        for (name, array) in &self.0 {
            let failed = |cause: String| NpzError::Array { name: name.clone(), cause };
            archive
                .start_file(format!("{name}.npy"), SimpleFileOptions::default())
                .map_err(|error| failed(error.to_string()))?;
            let npy = write_array(array).map_err(|error| failed(error.to_string()))?;
            archive.write_all(&npy).map_err(|error| failed(error.to_string()))?;
        }
        Ok(archive.finish().map_err(|e| NpzError::Archive(e.to_string()))?.into_inner())
    }

    pub fn get(&self, name: &str) -> Result<&Array, NpzError> {
        self.0.get(name).ok_or_else(|| NpzError::Missing(name.to_owned()))
    }

    pub fn insert(&mut self, name: impl Into<String>, shape: &[usize], values: Values) {
        self.0.insert(name.into(), Array { shape: shape.to_vec(), values });
    }
}

impl Array {
    /// Every value as f64; integers up to 2^53 are exact.
    pub fn to_f64(&self) -> Vec<f64> {
        match &self.values {
            Values::F32(values) => values.iter().map(|&value| f64::from(value)).collect(),
            Values::F64(values) => values.clone(),
            Values::I32(values) => values.iter().map(|&value| f64::from(value)).collect(),
            Values::I64(values) => values.iter().map(|&value| value as f64).collect(),
            Values::U8(values) => values.iter().map(|&value| f64::from(value)).collect(),
        }
    }
}

fn read_array(npy: &[u8]) -> Result<Option<Array>, String> {
    let open = || npyz::NpyFile::new(npy).map_err(|error| error.to_string());
    let shape = open()?.shape().iter().map(|&n| n as usize).collect();
    fn all<T: npyz::Deserialize + Copy>(file: npyz::NpyFile<&[u8]>) -> Option<Result<Vec<T>, String>> {
        let shape: Vec<usize> = file.shape().iter().map(|&n| n as usize).collect();
        let fortran = file.order() == npyz::Order::Fortran;
        let values = file.data::<T>().ok()?.collect::<Result<Vec<T>, _>>().map_err(|error| error.to_string());
        Some(values.map(|values| if fortran { from_fortran_order(&values, &shape) } else { values }))
    }
    let values = if let Some(values) = all::<f32>(open()?) {
        Values::F32(values?)
    } else if let Some(values) = all::<f64>(open()?) {
        Values::F64(values?)
    } else if let Some(values) = all::<i32>(open()?) {
        Values::I32(values?)
    } else if let Some(values) = all::<i64>(open()?) {
        Values::I64(values?)
    } else if let Some(values) = all::<i16>(open()?) {
        Values::I32(values?.into_iter().map(i32::from).collect())
    } else if let Some(values) = all::<u16>(open()?) {
        Values::I32(values?.into_iter().map(i32::from).collect())
    } else if let Some(values) = all::<u8>(open()?) {
        Values::U8(values?)
    } else {
        return Ok(None);
    };
    Ok(Some(Array { shape, values }))
}

/// Values whose first index runs fastest (NumPy saves transposed arrays so), in C order.
fn from_fortran_order<T: Copy>(values: &[T], shape: &[usize]) -> Vec<T> {
    let place = |at: usize| {
        let (mut rest, mut stride, mut place) = (at, values.len(), 0);
        for &side in shape.iter().rev() {
            stride /= side;
            place += rest % side * stride;
            rest /= side;
        }
        place
    };
    (0..values.len()).map(|at| values[place(at)]).collect()
}

fn write_array(array: &Array) -> std::io::Result<Vec<u8>> {
    fn all<T: npyz::AutoSerialize + Copy>(shape: &[u64], values: &[T]) -> std::io::Result<Vec<u8>> {
        let mut npy = Vec::new();
        let mut writer =
            npyz::WriteOptions::new().default_dtype().shape(shape).writer(Cursor::new(&mut npy)).begin_nd()?;
        writer.extend(values.iter().copied())?;
        writer.finish()?;
        Ok(npy)
    }
    let shape: Vec<u64> = array.shape.iter().map(|&n| n as u64).collect();
    match &array.values {
        Values::F32(values) => all(&shape, values),
        Values::F64(values) => all(&shape, values),
        Values::I32(values) => all(&shape, values),
        Values::I64(values) => all(&shape, values),
        Values::U8(values) => all(&shape, values),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_come_back_as_they_were_written() {
        let mut arrays = Arrays::default();
        arrays.insert("0000/positions", &[2, 3], Values::F32(vec![0.0, 1.5, -2.0, 3.0, 4.0, 5.0]));
        arrays.insert("0000/members", &[3], Values::I32(vec![7, -1, 9]));
        arrays.insert("0000/empty", &[0, 2], Values::F32(vec![]));
        arrays.insert("flags", &[2], Values::U8(vec![0, 1]));
        let bytes = arrays.write().expect("writes");
        assert_eq!(Arrays::read(&bytes).expect("reads"), arrays);
        assert_eq!(bytes, arrays.write().expect("writes again"));
    }

    #[test]
    fn arrays_saved_in_fortran_order_are_read_in_c_order() {
        // [2, 3, 2], value 100 i + 10 j + k; the first index runs fastest.
        let stored: Vec<i32> = (0..12).map(|at| 100 * (at % 2) + 10 * (at / 2 % 3) + at / 6).collect();
        let expected: Vec<i32> = (0..12).map(|at| 100 * (at / 6) + 10 * (at / 2 % 3) + at % 2).collect();
        assert_eq!(from_fortran_order(&stored, &[2, 3, 2]), expected);
    }

    #[test]
    fn bytes_that_are_no_archive_are_refused() {
        assert!(matches!(Arrays::read(b"not a zip"), Err(NpzError::Archive(_))));
    }
}
