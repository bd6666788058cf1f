//! JSON files that stand beside something: a model set's, a frozen reference, fault thresholds.

use plumbline_coordinator::reduce::outcome::Recipe;
use plumbline_coordinator::{reference, thresholds};
use plumbline_worker::learned::ModelSet;
use plumbline_worker::profile::{Profile, Rung};

pub(crate) fn target(bytes: &[u8]) {
    let path = crate::as_file("model.json", bytes);
    let directory = path.parent().expect("a file lies in a directory");
    let _model_set = ModelSet::read(directory);
    for recipe in [Recipe::Paper, Recipe::Balanced] {
        let _reference = reference::file::load(&path, recipe, None);
    }
    let _thresholds = thresholds::load(&path, &Profile::new(Rung::Standard));
}
