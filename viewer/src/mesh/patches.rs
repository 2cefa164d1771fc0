//! The patches of a view as the shaders read them: frames, anchors, edges.
//!
//! Frames come first for the corners and edge middles that patches use, then one for each patch at
//! the middle of its corners' plane. Each frame has an anchor in every dataset.

use areoid_cache::View;
use areoid_formats::body::Ellipsoid;
use glam::DVec3;

use super::detail::{Criterion, Detail, SEGMENTS};
use super::frame::{Frame, Ground, reference_point};
use super::tree::{Patch, Tree};
use crate::map::Maps;
use crate::mirror;
use crate::style::Plane;
use crate::surface::Surface;

const NONE: u32 = u32::MAX;

/// Bytes of a composed point: a position and a texel's size.
pub(crate) const POINT_BYTES: u64 = 16;

/// How many times as far apart as asked for vertices get where there is no room for more: with
/// thousands of datasets over one another.
const COARSEST: f64 = 64.0;

/// Slopes are taken from places so far outside a patch, as a chord, besides its own size.
const SLOPE_REACH: f64 = 0.01;

/// The geometry of one view. The buffers are kept from view to view.
#[derive(Debug, Default)]
pub(crate) struct Mesh {
    tree: Tree,
    exaggeration: f64,
    /// By corner of the tree.
    frame_of_corner: Vec<u32>,
    /// By edge of the tree.
    mirrored_edge: Vec<u32>,
    pub(crate) frames: Vec<Frame>,
    pub(crate) mirrored_frames: Vec<mirror::Frame>,
    pub(crate) anchors: Vec<mirror::Anchor>,
    pub(crate) edges: Vec<mirror::Edge>,
    pub(crate) patches: Vec<mirror::Patch>,
}

impl Mesh {
    /// Makes the patches of `view`: fewer than it asks for, where a list for the shaders would have more
    /// than `most_bytes`. Anchors for which there is no room then are left out.
    pub(crate) fn build(
        &mut self,
        view: &View,
        ellipsoid: Ellipsoid,
        surface: &Surface,
        detail: &mut Detail,
        maps: &Maps,
        most_bytes: u64,
    ) {
        let mut coarseness = 1.0;
        loop {
            self.split(view, ellipsoid, surface, detail, coarseness);
            let fits = self.anchor(view, maps, most_bytes) && self.largest_bytes() <= most_bytes;
            if fits || coarseness >= COARSEST {
                return;
            }
            coarseness *= 2.0;
        }
    }

    fn split(
        &mut self,
        view: &View,
        ellipsoid: Ellipsoid,
        surface: &Surface,
        detail: &mut Detail,
        coarseness: f64,
    ) {
        let criterion = Criterion::new(view, ellipsoid, detail, coarseness);
        let mut tree = std::mem::take(&mut self.tree);
        tree.build(|asked| criterion.verdict(detail, surface, asked));

        self.exaggeration = detail.exaggeration;
        self.frames.clear();
        self.edges.clear();
        self.patches.clear();
        self.frame_of_corner.clear();
        self.frame_of_corner.resize(tree.corners().len(), NONE);
        self.mirrored_edge.clear();
        for patch in tree.patches() {
            let patch = self.mirror_patch(&tree, patch, ellipsoid, &mut |normal| {
                detail.ground(surface, normal)
            });
            self.patches.push(patch);
        }
        self.tree = tree;
    }

    /// Makes the anchors of all frames; whether there was room for them.
    fn anchor(&mut self, view: &View, maps: &Maps, most_bytes: u64) -> bool {
        let most = usize::try_from(most_bytes).unwrap_or(usize::MAX) / size_of::<mirror::Anchor>();
        self.mirrored_frames.clear();
        self.anchors.clear();
        for frame in &self.frames {
            let mut lists = [count(self.anchors.len()); 5];
            for plane in Plane::ALL {
                for (dataset, map) in maps.of_plane(plane) {
                    if self.anchors.len() >= most {
                        break;
                    }
                    let reach = frame.reach + SLOPE_REACH;
                    self.anchors.extend(map.anchor(
                        dataset,
                        frame.ground.position,
                        frame.axes.z_axis,
                        reach,
                    ));
                }
                lists[plane as usize + 1] = count(self.anchors.len());
            }
            self.mirrored_frames.push(mirror::Frame { lists, ..frame.seen_from(view.eye) });
        }
        self.anchors.len() < most
    }

    /// Of the lists for the shaders.
    fn largest_bytes(&self) -> u64 {
        let bytes = [
            size_of_val(self.mirrored_frames.as_slice()),
            size_of_val(self.edges.as_slice()),
            size_of_val(self.patches.as_slice()),
        ];
        let points = self.points() as u64 * POINT_BYTES;
        bytes.iter().fold(points, |most, &bytes| most.max(bytes as u64))
    }

    #[expect(clippy::cast_possible_truncation, reason = "chords relative to their middles, shares")]
    fn mirror_patch(
        &mut self,
        tree: &Tree,
        patch: &Patch,
        ellipsoid: Ellipsoid,
        ground: &mut impl FnMut(DVec3) -> Ground,
    ) -> mirror::Patch {
        let mut sides = 0;
        let mut edges = [0; 3];
        for (i, side) in patch.edges.iter().enumerate() {
            sides |= (side.first | side.last << 2) << (4 * i);
            edges[i] = self.mirror_edge(tree, side.edge, ellipsoid, ground);
        }
        let corners = patch.corners.map(|i| tree.corners()[i as usize]);
        let middle = (corners[0] + corners[1] + corners[2]) / 3.0;
        let normal = middle.normalize();
        let frame =
            self.add_frame(Frame::new(&ellipsoid, normal, ground(normal), self.exaggeration));
        let reach = corners.iter().map(|corner| corner.distance(normal)).fold(0.0, f64::max);
        self.frames[frame as usize].reach = 2.0 * reach;
        let axes = self.frames[frame as usize].axes;
        let [corner_a, corner_b, corner_c] =
            corners.map(|corner| (axes.transpose() * (corner - middle)).as_vec3().to_array());
        let distance = middle.length() as f32;
        mirror::Patch {
            corner_a,
            frame,
            corner_b,
            sides,
            corner_c,
            distance,
            edges,
            come: patch.come as f32,
        }
    }

    #[expect(clippy::cast_possible_truncation, reason = "chords relative to their middles, shares")]
    fn mirror_edge(
        &mut self,
        tree: &Tree,
        edge: u32,
        ellipsoid: Ellipsoid,
        ground: &mut impl FnMut(DVec3) -> Ground,
    ) -> u32 {
        let index = edge as usize;
        if self.mirrored_edge.len() <= index {
            self.mirrored_edge.resize(index + 1, NONE);
        }
        if self.mirrored_edge[index] != NONE {
            return self.mirrored_edge[index];
        }
        let edge = tree.edge(edge);
        let frames = [edge.start, edge.middle(), edge.end].map(|corner| {
            if self.frame_of_corner[corner as usize] == NONE {
                let normal = tree.corners()[corner as usize];
                let frame = Frame::new(&ellipsoid, normal, ground(normal), self.exaggeration);
                self.frame_of_corner[corner as usize] = self.add_frame(frame);
            }
            self.frame_of_corner[corner as usize]
        });
        let [start, end] = [edge.start, edge.end].map(|i| tree.corners()[i as usize]);
        let chord = end - start;
        let middle = &mut self.frames[frames[1] as usize];
        middle.reach = middle.reach.max(chord.length());
        let axes = middle.axes;
        let direction = (axes.transpose() * chord).truncate().normalize();
        let half_chord = 0.5 * chord.length();
        self.edges.push(mirror::Edge {
            frames,
            half_chord: half_chord as f32,
            direction: direction.as_vec2().to_array(),
            distance: (1.0 - half_chord * half_chord).sqrt() as f32,
            come: edge.come() as f32,
        });
        let mirrored = count(self.edges.len() - 1);
        self.mirrored_edge[index] = mirrored;
        mirrored
    }

    /// How many points the shaders compose: those of the edges, and those inside the patches.
    pub(crate) fn composed_points(&self) -> usize {
        let side = SEGMENTS as usize + 1;
        self.edges.len() * side + self.patches.len() * ((side - 2) * (side - 3) / 2)
    }

    /// How many points there is room for: of the edges, and then of the patches, with their sides.
    pub(crate) fn points(&self) -> usize {
        let side = SEGMENTS as usize + 1;
        self.edges.len() * side + self.patches.len() * (side * (side + 1) / 2)
    }

    fn add_frame(&mut self, frame: Frame) -> u32 {
        self.frames.push(frame);
        count(self.frames.len() - 1)
    }

    /// The unit normal and body-fixed reference point of a place in a patch, and the height that the
    /// shaders tell heights from there.
    pub(crate) fn place(
        &self,
        ellipsoid: &Ellipsoid,
        patch: u32,
        weights: [f32; 2],
    ) -> (DVec3, DVec3, f64) {
        let patch = &self.patches[patch as usize];
        let [a, b, c] = [patch.corner_a, patch.corner_b, patch.corner_c]
            .map(|corner| glam::Vec3::from_array(corner).as_dvec3());
        let [to_b, to_c] = weights.map(f64::from);
        let chord = a + to_b * (b - a) + to_c * (c - a) + DVec3::Z * f64::from(patch.distance);
        let normal = (self.frames[patch.frame as usize].axes * chord).normalize();
        let base_m = f64::from(self.frames[patch.frame as usize].ground.height_m);
        (normal, reference_point(ellipsoid, normal), base_m)
    }
}

fn count(length: usize) -> u32 {
    u32::try_from(length).expect("a mesh that fits in memory has fewer than 2^32 of anything")
}
