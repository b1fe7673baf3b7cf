//! [`ZoneError`]: why values make no zone.

/// Error for values that make no [`Zone`](super::Zone).
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ZoneError {
    /// A range is empty, negative or not finite.
    #[error("invalid range from {near} to {far} m: expected 0 or more, the smaller one first")]
    Range {
        /// Smaller distance in metres.
        near: f64,
        /// Larger distance in metres.
        far: f64,
    },
    /// A coordinate is not a number, or beyond 1,000 m.
    #[error("invalid vertex {index} at {x}, {y}: expected -1000 to 1000 m")]
    Vertex {
        /// Index of the vertex, from 0.
        index: usize,
        /// Metres ahead.
        x: f64,
        /// Metres to the left.
        y: f64,
    },
    /// A polygon has fewer than 3 different vertices, or more than 1,000.
    #[error("invalid polygon: expected 3 to 1000 vertices, found {found}")]
    Vertices {
        /// Number of vertices, without repeated ones.
        found: usize,
    },
    /// Two edges of a polygon cross, touch or cover each other.
    #[error(
        "invalid polygon: the edge that starts at {x}, {y} touches another one: order the vertices along the outline"
    )]
    Crossing {
        /// Metres ahead.
        x: f64,
        /// Metres to the left.
        y: f64,
    },
}
