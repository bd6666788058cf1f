//! What `tests/parity/export_prototype.py` wrote of one clip; its documentation lists the arrays.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use npyz::npz::NpzArchive;
use plumbline_vision::consistency::GridFlow;
use plumbline_vision::flow::Flow;
use plumbline_vision::image::{Plane, Rgb8};

/// An opened file.
pub(crate) struct Export {
    archive: NpzArchive<BufReader<File>>,
    /// Height of the frames, whose pixels are the flow's unit.
    pub(crate) reference_height_px: f64,
}

impl Export {
    pub(crate) fn open(path: &Path) -> Self {
        let file = File::open(path).unwrap_or_else(|error| panic!("{path:?}: {error}"));
        let mut export = Self {
            archive: NpzArchive::new(BufReader::new(file)).unwrap(),
            reference_height_px: 0.0,
        };
        export.reference_height_px = export.value("reference_height_px");
        export
    }

    pub(crate) fn has(&self, name: &str) -> bool {
        self.archive.array_names().any(|known| known == name)
    }

    fn array<T: npyz::Deserialize>(&mut self, name: &str) -> (Vec<usize>, Vec<T>) {
        let array = self.archive.by_name(name).unwrap();
        let array = array.unwrap_or_else(|| panic!("{name} is missing"));
        let shape = array.shape().iter().map(|&length| length as usize);
        (shape.collect(), array.into_vec().unwrap())
    }

    pub(crate) fn value(&mut self, name: &str) -> f64 {
        self.array(name).1[0]
    }

    /// A series; what the prototype left undefined (NaN) is `None`.
    pub(crate) fn series(&mut self, name: &str) -> Vec<Option<f64>> {
        let values = if self.is_f32(name) {
            let (_, values) = self.array::<f32>(name);
            values.into_iter().map(f64::from).collect()
        } else {
            self.array::<f64>(name).1
        };
        let defined = |value: f64| value.is_finite().then_some(value);
        values.into_iter().map(defined).collect()
    }

    pub(crate) fn indices(&mut self, name: &str) -> Vec<usize> {
        let (_, values) = self.array::<i64>(name);
        values.into_iter().map(|value| value as usize).collect()
    }

    pub(crate) fn pictures(&mut self, name: &str) -> Vec<Rgb8> {
        let (shape, bytes) = self.array::<u8>(name);
        let pixels = bytes.chunks_exact(shape[1] * shape[2] * 3);
        let picture = |data: &[u8]| Rgb8::new(shape[2], shape[1], data.to_vec()).unwrap();
        pixels.map(picture).collect()
    }

    pub(crate) fn planes(&mut self, name: &str) -> Vec<Plane> {
        let (shape, bytes) = self.array::<u8>(name);
        let plane = |data: &[u8]| {
            let levels = data.iter().map(|&level| f32::from(level)).collect();
            Plane::new(shape[2], shape[1], levels).unwrap()
        };
        bytes.chunks_exact(shape[1] * shape[2]).map(plane).collect()
    }

    /// Flows on the prototype's grid, which is as wide as it is high.
    pub(crate) fn grid_flows(&mut self, name: &str) -> Vec<GridFlow> {
        let (shape, vectors) = self.vectors(name);
        let side = shape[1];
        let cells_per_px = (side as f64 / self.reference_height_px) as f32;
        let flow = |vectors: &[[f32; 2]]| GridFlow {
            width: side,
            height: side,
            cells_per_px: [cells_per_px; 2],
            flow_px: vectors.to_vec(),
        };
        vectors.chunks_exact(side * side).map(flow).collect()
    }

    pub(crate) fn flow(&mut self, name: &str) -> Flow {
        let (shape, data) = self.vectors(name);
        Flow {
            width: shape[1],
            height: shape[0],
            data,
        }
    }

    /// Vectors in pixels, stored as float32, or as int16 in units of `flow_unit_px`.
    fn vectors(&mut self, name: &str) -> (Vec<usize>, Vec<[f32; 2]>) {
        let (shape, values) = if self.is_f32(name) {
            self.array::<f32>(name)
        } else {
            let unit_px = self.value("flow_unit_px") as f32;
            let (shape, units) = self.array::<i16>(name);
            let px = |unit: i16| f32::from(unit) * unit_px;
            (shape, units.into_iter().map(px).collect())
        };
        (
            shape,
            values.chunks_exact(2).map(|v| [v[0], v[1]]).collect(),
        )
    }

    fn is_f32(&mut self, name: &str) -> bool {
        let array = self.archive.by_name(name).unwrap();
        let array = array.unwrap_or_else(|| panic!("{name} is missing"));
        array.dtype().descr() == "'<f4'"
    }
}
