//! The correspondence operator: what finds the cells of one frame in another.
//!
//! A tracker asks for all active edges at once, with where it now believes the cells to be; the
//! operator answers where they are and how far to trust that. A learned operator refines its last
//! answer step by step and keeps a state per [`EdgeId`]; a flow operator answers the same whatever the
//! belief.

/// Names an edge for as long as a tracker lives.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct EdgeId(pub u64);

/// One edge that is asked for.
#[derive(Debug, Clone, Copy)]
pub struct EdgeQuery<'a> {
    /// The edge.
    pub id: EdgeId,
    /// Input frame whose cells are sought.
    pub source_frame: usize,
    /// Input frame they are sought in.
    pub target_frame: usize,
    /// `[2, rows, columns]`: where poses and depths put them now: column, then row, in cells.
    pub reprojected: &'a [f32],
    /// `[2, rows, columns]`: the last answer; at first the reprojection at the edge's birth.
    pub last_target: &'a [f32],
}

/// Where the answer to one edge goes.
#[derive(Debug)]
pub struct EdgeAnswer<'a> {
    /// `[2, rows, columns]`: where the cells are, in cells of the target.
    pub at: &'a mut [f32],
    /// `[2, rows, columns]`: what that is worth, in [0, 1].
    pub weight: &'a mut [f32],
}

/// Finds correspondences.
pub trait CorrespondenceOperator {
    /// Why it may fail.
    type Error: std::error::Error + Send + Sync + 'static;

    /// Answers every query, in order.
    ///
    /// # Errors
    /// Whatever the operator meets.
    fn update(
        &mut self,
        queries: &[EdgeQuery<'_>],
        answers: &mut [EdgeAnswer<'_>],
    ) -> Result<(), Self::Error>;

    /// Damping of the inverse depths of a source of the last update, `[rows, columns]`, before the
    /// reference's factor of 0.2.
    ///
    /// # Errors
    /// Whatever the operator meets.
    fn depth_damping(
        &mut self,
        source_frame: usize,
        damping: &mut [f32],
    ) -> Result<(), Self::Error>;

    /// A keyframe was removed: it will not be asked for again.
    fn forget(&mut self, _frame: usize) {}
}
