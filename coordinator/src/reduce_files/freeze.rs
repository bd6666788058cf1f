//! Rows in files as a frozen reference, in memory that does not grow with them.

use std::collections::BTreeMap;
use std::path::Path;

use super::scoring::{Yardsticks, score};
use super::{ReduceFilesError, ReduceFilesOptions, all_in_order, beside, parts};
use crate::publish::ProfileRecord;
use crate::reduce::ReduceOptions;
use crate::reduce::outcome::FEWEST_ROWS;
use crate::reduce::population::survey;
use crate::reduce::reference::Frozen;

/// Freezes the scored rows that the sources hold; `out`, recipe, keep rule and formats say nothing here.
/// Also says what measured them, where a run's `corpus.json` lies beside them. Scratch files without a
/// name go into `scratch`.
///
/// # Errors
/// [`ReduceFilesError`].
pub fn freeze(
    options: &ReduceFilesOptions,
    scratch: &Path,
) -> Result<(Frozen, Option<ProfileRecord>), ReduceFilesError> {
    let files = parts::files(&options.sources)?;
    let (intake, _) = all_in_order(&files, options, scratch)?;
    if intake.scored < FEWEST_ROWS {
        return Err(ReduceFilesError::TooFewRows {
            rows: intake.scored,
            least: FEWEST_ROWS,
        });
    }
    let of_rows = ReduceOptions {
        profile_digest: intake.profile_digest.clone().unwrap_or_default(),
        ..options.reduce.clone()
    };
    let surveyed = survey(intake.scored, &intake.signals, of_rows.bins, of_rows.range)?;
    let groups = BTreeMap::new();
    let frozen = Frozen::freeze(&surveyed, &intake.signals, &of_rows, &mut |recipe| {
        let of_recipe = ReduceOptions {
            recipe,
            ..of_rows.clone()
        };
        let yardsticks = Yardsticks::of(&surveyed, &groups, &intake, &of_recipe);
        score(&intake, &yardsticks, &of_recipe, scratch, options.threads)
    })?;
    Ok((
        frozen,
        beside(&files, intake.profile_digest.as_ref()).and_then(|corpus| corpus.profile),
    ))
}
