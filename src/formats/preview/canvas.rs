//! A small picture with a depth buffer: triangles, kites and dots, drawn larger and averaged down.
//!
//! Places are in pixels of the finished picture, x to the right and y down; z grows towards the viewer.

use glam::{DVec2, DVec3, Vec3};

/// One panel of a picture, `factor` times as wide and as high as it will be.
pub struct Canvas {
    width: usize,
    height: usize,
    factor: usize,
    /// Linear light, `[height · factor, width · factor, 3]`.
    colours: Vec<Vec3>,
    depths: Vec<f32>,
}

/// A corner of a triangle: where, and in which linear light.
pub struct Corner {
    pub place: DVec3,
    pub colour: Vec3,
}

impl Canvas {
    pub fn new(width: u32, height: u32, factor: u32, background: Vec3) -> Self {
        let (width, height, factor) = (width as usize, height as usize, factor as usize);
        let count = width * height * factor * factor;
        Self { width, height, factor, colours: vec![background; count], depths: vec![f32::NEG_INFINITY; count] }
    }

    /// The samples whose centres may lie between `low` and `high`: their ranges in x and y.
    fn samples(&self, low: DVec2, high: DVec2) -> (std::ops::Range<usize>, std::ops::Range<usize>) {
        // `as` saturates: what lies left of or above the picture becomes 0.
        let range = |low: f64, high: f64, count: usize| {
            let first = (low * self.factor as f64 - 0.5).ceil() as usize;
            let last = (high * self.factor as f64 + 0.5).floor() as usize;
            first.min(count)..last.min(count)
        };
        (range(low.x, high.x, self.width * self.factor), range(low.y, high.y, self.height * self.factor))
    }

    fn centre_of(&self, column: usize, row: usize) -> DVec2 {
        DVec2::new(column as f64 + 0.5, row as f64 + 0.5) / self.factor as f64
    }

    /// Fills a triangle where it is nearer than what is there, its corners' colours blended across it.
    pub fn triangle(&mut self, corners: &[Corner; 3]) {
        let [a, b, c] = [0, 1, 2].map(|corner| corners[corner].place.truncate());
        let area = (b - a).perp_dot(c - a);
        if area == 0.0 {
            return;
        }
        let (columns, rows) = self.samples(a.min(b).min(c), a.max(b).max(c));
        for row in rows {
            for column in columns.clone() {
                let place = self.centre_of(column, row);
                let u = (c - b).perp_dot(place - b) / area;
                let v = (a - c).perp_dot(place - c) / area;
                let w = 1.0 - u - v;
                if u < 0.0 || v < 0.0 || w < 0.0 {
                    continue;
                }
                let depth = (u * corners[0].place.z + v * corners[1].place.z + w * corners[2].place.z) as f32;
                let sample = row * self.width * self.factor + column;
                if depth > self.depths[sample] {
                    self.depths[sample] = depth;
                    self.colours[sample] =
                        corners[0].colour * u as f32 + corners[1].colour * v as f32 + corners[2].colour * w as f32;
                }
            }
        }
    }

    /// A bone: a kite that is widest near `from` and ends in `to`, with an outline.
    pub fn kite(&mut self, from: DVec2, to: DVec2, fill: Vec3, outline: Vec3) {
        let along = to - from;
        let length = along.length();
        if length < 0.5 {
            return;
        }
        let half_width = (length * 0.07).clamp(1.0, 3.2);
        let across = along.perp() / length * half_width;
        let shoulder = from + along * 0.15;
        // Counter-clockwise, so that the inside is to the left of every edge.
        let outer = [from, shoulder - across, to, shoulder + across];
        self.convex(&outer, 1.0, outline);
        self.convex(&outer, 0.0, fill);
    }

    /// A convex polygon grown by `grow` pixels, in front of everything.
    fn convex(&mut self, polygon: &[DVec2], grow: f64, colour: Vec3) {
        let inside = |place: DVec2| {
            polygon.iter().zip(polygon.iter().cycle().skip(1)).all(|(&start, &end)| {
                let edge = (end - start).normalize_or_zero();
                edge.perp_dot(place - start) >= -grow
            })
        };
        let low = polygon.iter().copied().fold(DVec2::INFINITY, DVec2::min) - grow;
        let high = polygon.iter().copied().fold(DVec2::NEG_INFINITY, DVec2::max) + grow;
        self.fill(low, high, inside, colour);
    }

    /// A disc in front of everything.
    pub fn dot(&mut self, centre: DVec2, radius: f64, colour: Vec3) {
        let inside = |place: DVec2| place.distance_squared(centre) <= radius * radius;
        self.fill(centre - radius, centre + radius, inside, colour);
    }

    fn fill(&mut self, low: DVec2, high: DVec2, inside: impl Fn(DVec2) -> bool, colour: Vec3) {
        let (columns, rows) = self.samples(low, high);
        for row in rows {
            for column in columns.clone() {
                if inside(self.centre_of(column, row)) {
                    self.colours[row * self.width * self.factor + column] = colour;
                }
            }
        }
    }

    /// Row `row` of the finished picture, in sRGB, appended to `bytes`.
    fn append_row(&self, row: usize, bytes: &mut Vec<u8>) {
        let share = 1.0 / (self.factor * self.factor) as f32;
        let stride = self.width * self.factor;
        for column in 0..self.width {
            let mut light = Vec3::ZERO;
            for y in row * self.factor..(row + 1) * self.factor {
                let start = y * stride + column * self.factor;
                light += self.colours[start..start + self.factor].iter().sum::<Vec3>();
            }
            bytes.extend((light * share).to_array().map(srgb));
        }
    }
}

/// Linear light to an 8-bit sRGB value (IEC 61966-2-1).
fn srgb(light: f32) -> u8 {
    let light = light.clamp(0.0, 1.0);
    let encoded = if light <= 0.003_130_8 { 12.92 * light } else { 1.055 * light.powf(1.0 / 2.4) - 0.055 };
    (encoded * 255.0 + 0.5) as u8
}

/// The panels beside each other as one PNG. All have the same height.
pub fn png(panels: &[Canvas]) -> Vec<u8> {
    let height = panels.iter().map(|panel| panel.height).min().unwrap_or(0);
    let width: usize = panels.iter().map(|panel| panel.width).sum();
    let mut pixels = Vec::with_capacity(width * height * 3);
    for row in 0..height {
        for panel in panels {
            panel.append_row(row, &mut pixels);
        }
    }
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width as u32, height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header().expect("a picture of at least one pixel, written to memory");
    writer.write_image_data(&pixels).expect("as many pixels as the header says");
    writer.finish().expect("written to memory");
    bytes
}
