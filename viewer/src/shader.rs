//! The shaders, put together from their files.
//!
//! A file may use what stands before it in the list of its program.

/// Everything that finds and composes values of a place.
pub(crate) const SURFACE: &[&str] = &[
    include_str!("shader/angle.wgsl"),
    include_str!("shader/scene.wgsl"),
    include_str!("shader/frame.wgsl"),
    include_str!("shader/map.wgsl"),
    include_str!("shader/page_table.wgsl"),
    include_str!("shader/texels.wgsl"),
    include_str!("shader/blend.wgsl"),
    include_str!("shader/ramp.wgsl"),
    include_str!("shader/compose.wgsl"),
    include_str!("shader/patch.wgsl"),
];

/// The finished picture onto a surface.
pub(crate) const PRESENT: &str = include_str!("shader/present.wgsl");

/// The programs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Program {
    /// The surface at the points of patches.
    Points,
    /// Patches into the deferred buffer.
    Mesh,
    /// The deferred buffer into the picture.
    Shade,
    /// The deferred buffer into numbers.
    Measure,
}

impl Program {
    /// The WGSL text.
    pub(crate) fn source(self) -> String {
        let deferred = include_str!("shader/deferred.wgsl");
        let own: &[&str] = match self {
            Self::Points => &[include_str!("shader/points.wgsl")],
            Self::Mesh => &[include_str!("shader/mesh.wgsl")],
            Self::Shade => &[
                deferred,
                include_str!("shader/color.wgsl"),
                include_str!("shader/atmosphere.wgsl"),
                include_str!("shader/debug.wgsl"),
                include_str!("shader/footprint.wgsl"),
                include_str!("shader/shade.wgsl"),
            ],
            Self::Measure => &[deferred, include_str!("shader/measure.wgsl")],
        };
        [SURFACE, own].concat().join("\n")
    }
}
