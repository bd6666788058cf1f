//! `rewards.*`: rewards of the scored videos, for preference and reinforcement learning.

use crate::publish::table::Column;
use crate::publish::table::Kind::{Bool, Float64, Text, UInt64};
use crate::reduce::rewards::Reward;

/// The columns of `rewards.*`.
#[must_use]
pub fn reward_columns() -> Vec<Column<Reward>> {
    vec![
        Column::field("video", Text, |r| r.video.as_str().into()),
        Column::field("group", Text, |r| r.group.as_deref().into()),
        Column::field("raw", Float64, |r| r.raw.into()),
        Column::field("percentile", Float64, |r| r.percentile.into()),
        Column::field("soft", Float64, |r| r.soft.into()),
        Column::field("group_rank", UInt64, |r| r.group_rank.into()),
        Column::field("group_size", UInt64, |r| r.group_size.into()),
        // Best of N: what rejection sampling keeps of a prompt's rollouts.
        Column::field("best_of_group", Bool, |r| (r.group_rank == 1).into()),
    ]
}
