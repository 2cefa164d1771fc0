//! The panel: what it shows is given to it, and what the user changes it writes down.

use areoid_cache::{Datasets, Stats};
use areoid_formats::body::Ellipsoid;
use areoid_formats::page::Kind;
use areoid_formats::units::Degrees;
use egui::{Checkbox, Context, DragValue, Key, Slider, Ui};

use super::arrangement::Arrangement;
use super::host::{Insertion, InsertionState};
use super::legend::legend;
use super::settings::{Lighting, Settings, ramp};
use crate::pick::Picked;
use crate::render::{Debug, FrameStatistics};
use crate::style::Role;

/// What the panel tells.
#[derive(Clone, Debug, Default)]
pub(super) struct Figures {
    pub(super) frame: FrameStatistics,
    pub(super) frame_ms: f64,
    pub(super) missing: usize,
    pub(super) wanted: usize,
    /// The tolerance that was met, in pixels.
    pub(super) met_px: f64,
    pub(super) stats: Stats,
    pub(super) under_cursor: Option<Picked>,
    /// The name of the dataset there.
    pub(super) dataset: String,
    pub(super) insertions: Vec<Insertion>,
    /// What was done last.
    pub(super) message: String,
    pub(super) bookmarks: usize,
    pub(super) is_recording: bool,
}

/// What the user asks for in the panel.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Wish {
    Insert(String),
    AddBookmark,
    GoTo(usize),
    Record,
    Screenshot,
}

/// What the panel keeps between frames.
#[derive(Clone, Debug, Default)]
pub(super) struct Panel {
    raster: String,
    /// A time in UTC.
    date: String,
    /// What is wrong with it.
    date_error: Option<&'static str>,
}

impl Panel {
    /// Shows the panel; what the user asks for is returned.
    pub(super) fn show(
        &mut self,
        context: &Context,
        settings: &mut Settings,
        datasets: &Datasets,
        figures: &Figures,
    ) -> Vec<Wish> {
        let mut wishes = Vec::new();
        let window = egui::Window::new("Areoid").default_pos([8.0, 8.0]).default_width(270.0);
        window.vscroll(true).show(context, |ui| {
            under_cursor(ui, figures);
            ui.collapsing("Datasets", |ui| layers(ui, settings, datasets));
            ui.collapsing("Insert", |ui| self.insert(ui, figures, &mut wishes));
            ui.collapsing("Picture", |ui| picture(ui, settings, datasets));
            ui.collapsing("Light", |ui| {
                light(ui, settings);
                if let (Lighting::Sun, Some((_, info))) =
                    (settings.lighting, datasets.iter().next())
                {
                    self.date(ui, settings, &info.grid.crs().body);
                }
            });
            ui.collapsing("Views", |ui| views(ui, settings, figures, &mut wishes));
            ui.collapsing("Figures", |ui| statistics(ui, figures));
            if !figures.message.is_empty() {
                ui.label(&figures.message);
            }
        });
        wishes
    }

    fn date(&mut self, ui: &mut Ui, settings: &mut Settings, body: &Ellipsoid) {
        ui.horizontal(|ui| {
            let hint = egui::TextEdit::singleline(&mut self.date).hint_text("2026-11-29T12:00:00");
            let field = ui.add(hint.desired_width(150.0));
            let is_entered = field.lost_focus() && ui.input(|input| input.key_pressed(Key::Enter));
            if ui.button("sun at this time").clicked() || is_entered {
                self.date_error = settings.set_date(&self.date, body).err();
            }
        });
        if let Some(reason) = self.date_error {
            ui.colored_label(ui.visuals().error_fg_color, reason);
        }
    }

    fn insert(&mut self, ui: &mut Ui, figures: &Figures, wishes: &mut Vec<Wish>) {
        ui.label("Drag a raster onto the window, or name it:");
        ui.horizontal(|ui| {
            let named = ui.text_edit_singleline(&mut self.raster);
            let is_entered = named.lost_focus() && ui.input(|input| input.key_pressed(Key::Enter));
            let is_asked = ui.button("Insert").clicked() || is_entered;
            if is_asked && !self.raster.trim().is_empty() {
                wishes.push(Wish::Insert(self.raster.trim().to_owned()));
            }
        });
        for insertion in &figures.insertions {
            match &insertion.state {
                InsertionState::Running(percent) => {
                    let share = f32::from(*percent) / 100.0;
                    let text = format!("{} {percent} %", insertion.name);
                    ui.add(egui::ProgressBar::new(share).text(text));
                }
                InsertionState::Done => {
                    ui.label(format!("{}: in the catalog", insertion.name));
                }
                InsertionState::Failed(reason) => {
                    let text = format!("{}: {reason}", insertion.name);
                    ui.colored_label(ui.visuals().error_fg_color, text);
                }
            }
        }
    }
}

fn under_cursor(ui: &mut Ui, figures: &Figures) {
    for line in told(figures) {
        ui.monospace(line);
    }
}

/// Place, height and dataset under the cursor: as many lines whatever is there, so that nothing below
/// them moves.
fn told(figures: &Figures) -> [String; 3] {
    let blank = || " ".to_owned();
    let Some(picked) = &figures.under_cursor else { return ["—".to_owned(), blank(), blank()] };
    let [longitude, latitude] =
        [picked.place.longitude, picked.place.latitude].map(|angle| Degrees::from(angle).0);
    let place = format!("{longitude:.5}°, {latitude:.5}°");
    let Some(found) = &picked.height else { return [place, "no height".to_owned(), blank()] };
    let height = format!("{:.1} m ± {:.1} m", found.value[0], found.bound);
    [place, height, format!("{}, level {:.1}", figures.dataset, found.level)]
}

/// What the user names: a dataset, or a group of them.
#[derive(Clone, Debug, PartialEq)]
struct Row<'a> {
    name: &'a str,
    kind: Kind,
    priority: i32,
    /// The names of the group's parts.
    parts: Vec<&'a str>,
}

/// A row for each group and for each dataset of none, in the order of their first.
fn rows(datasets: &Datasets) -> Vec<Row<'_>> {
    let mut rows: Vec<Row<'_>> = Vec::new();
    for (_, info) in datasets.iter() {
        let name = info.group.as_ref().unwrap_or(&info.name);
        let part = info.group.is_some().then_some(info.name.as_str());
        if let Some(row) = rows.iter_mut().find(|row| row.name == name) {
            row.parts.extend(part);
        } else {
            let parts = part.into_iter().collect();
            rows.push(Row { name, kind: info.kind, priority: info.priority, parts });
        }
    }
    rows
}

fn layers(ui: &mut Ui, settings: &mut Settings, datasets: &Datasets) {
    for row in rows(datasets) {
        let kind = match row.kind {
            Kind::Height => "height",
            Kind::Color => "color",
            Kind::Normal => "normal",
        };
        let before = settings.layer(row.name);
        let mut layer = before.clone();
        ui.horizontal(|ui| {
            let mut is_shown = layer.weight > 0.0;
            if ui.checkbox(&mut is_shown, row.name).changed() {
                layer.weight = if is_shown { 1.0 } else { 0.0 };
            }
            ui.weak(kind);
            if !row.parts.is_empty() {
                ui.weak(format!("in {} parts", row.parts.len()));
            }
        });
        ui.indent(row.name, |ui| {
            ui.horizontal(|ui| {
                ui.add(Slider::new(&mut layer.weight, 0.0..=1.0).fixed_decimals(2).text("weight"));
            });
            ui.horizontal(|ui| {
                let mut priority = layer.priority.unwrap_or(row.priority);
                ui.label("order");
                if ui.add(DragValue::new(&mut priority)).changed() {
                    layer.priority = Some(priority);
                }
                ui.label("series");
                ui.add(DragValue::new(&mut layer.series).range(0..=99));
                if row.kind == Kind::Height {
                    let (mut has_ramp, ramp) = (layer.ramp.is_some(), ramp());
                    let may = has_ramp || settings.style.has_room(ramp.stops.len());
                    if ui.add_enabled(may, Checkbox::new(&mut has_ramp, "colors")).changed() {
                        layer.ramp = has_ramp.then_some(ramp);
                    }
                }
                if row.kind == Kind::Color {
                    let mut is_luminance = layer.role == Role::Luminance;
                    ui.checkbox(&mut is_luminance, "luminance");
                    layer.role = if is_luminance { Role::Luminance } else { Role::Color };
                }
            });
        });
        if layer != before {
            settings.set_layer(layer, &row.parts);
        }
    }
}

fn picture(ui: &mut Ui, settings: &mut Settings, datasets: &Datasets) {
    let tolerance = Slider::new(&mut settings.tolerance_px, 0.25..=16.0).logarithmic(true);
    ui.add(tolerance.text("tolerance, px"));
    ui.add(Slider::new(&mut settings.exaggeration, 0.0..=20.0).text("heights ×"));
    ui.checkbox(&mut settings.has_ramp, "colors by height");
    ui.horizontal(|ui| {
        for (debug, name) in [
            (Debug::Off, "plain"),
            (Debug::Level, "level"),
            (Debug::Dataset, "dataset"),
            (Debug::Borders, "pages"),
            (Debug::Residency, "residency"),
            (Debug::Error, "error"),
        ] {
            ui.selectable_value(&mut settings.debug, debug, name);
        }
    });
    legend(ui, settings, datasets);
}

fn light(ui: &mut Ui, settings: &mut Settings) {
    ui.horizontal(|ui| {
        ui.selectable_value(&mut settings.lighting, Lighting::Headlamp, "headlamp");
        ui.selectable_value(&mut settings.lighting, Lighting::Sun, "sun");
        ui.selectable_value(&mut settings.lighting, Lighting::Relief, "relief");
    });
    if settings.lighting == Lighting::Sun {
        ui.add(Slider::new(&mut settings.sun[0], -180.0..=180.0).text("sun's longitude"));
        ui.add(Slider::new(&mut settings.sun[1], -90.0..=90.0).text("sun's latitude"));
    }
    if settings.lighting == Lighting::Relief {
        ui.add(Slider::new(&mut settings.relief[0], 0.0..=360.0).text("light from"));
        ui.add(Slider::new(&mut settings.relief[1], 0.0..=90.0).text("light's height"));
    }
    ui.add(Slider::new(&mut settings.exposure, 0.1..=10.0).logarithmic(true).text("exposure"));
    ui.checkbox(&mut settings.has_air, "atmosphere");
}

fn views(ui: &mut Ui, settings: &mut Settings, figures: &Figures, wishes: &mut Vec<Wish>) {
    ui.horizontal(|ui| {
        for (arrangement, name) in Arrangement::ALL {
            ui.selectable_value(&mut settings.arrangement, arrangement, name);
        }
    });
    ui.horizontal(|ui| {
        if ui.button("Bookmark (B)").clicked() {
            wishes.push(Wish::AddBookmark);
        }
        for place in 0..figures.bookmarks {
            if ui.button(format!("{}", place + 1)).clicked() {
                wishes.push(Wish::GoTo(place));
            }
        }
    });
    ui.horizontal(|ui| {
        let text = if figures.is_recording { "Stop recording (R)" } else { "Record a flight (R)" };
        if ui.button(text).clicked() {
            wishes.push(Wish::Record);
        }
        if ui.button("Screenshot (P)").clicked() {
            wishes.push(Wish::Screenshot);
        }
    });
}

fn statistics(ui: &mut Ui, figures: &Figures) {
    let Figures { frame, stats, .. } = figures;
    ui.monospace(format!("{:.1} ms to encode", figures.frame_ms));
    ui.monospace(format!("{} patches, {} triangles", frame.patches, frame.triangles));
    ui.monospace(format!("{} pages wanted, {} missing", figures.wanted, figures.missing));
    ui.monospace(format!("{:.2} px met", figures.met_px));
    ui.monospace(format!(
        "{} of {} MiB, {} pages",
        stats.bytes >> 20,
        stats.budget_bytes >> 20,
        stats.pages
    ));
    ui.monospace(format!("{} loads, {} dropped", stats.loads, stats.evictions));
}

#[cfg(test)]
mod tests {
    use super::*;
    use areoid_cache::DatasetInfo;
    use areoid_formats::body::Body;
    use areoid_formats::grid::{Grid, Outline};
    use areoid_formats::projection::{Crs, Projection};

    fn info(name: &str, group: Option<&str>, priority: i32) -> DatasetInfo {
        let crs = Crs::new(Projection::Geographic, Body::parse("mars").unwrap().ellipsoid);
        let outline = Outline { origin: [0.0; 2], pixel_size: [1.0; 2], width: 4, height: 4 };
        let grid = Grid::from_outline(crs, outline, 64).unwrap().grid;
        let (name, group) = (name.to_owned(), group.map(str::to_owned));
        DatasetInfo { name, group, kind: Kind::Height, grid, priority }
    }

    #[test]
    fn a_group_is_one_row_and_a_name_with_a_dot_alone_is_none() {
        let datasets = Datasets::from(vec![
            info("ice.1999", None, 1),
            info("mola.band", Some("mola"), 5),
            info("ice.2020", None, 2),
            info("mola.north", Some("mola"), 5),
        ]);
        let found = rows(&datasets);
        let names: Vec<_> = found.iter().map(|row| (row.name, row.priority)).collect();
        assert_eq!(names, [("ice.1999", 1), ("mola", 5), ("ice.2020", 2)]);
        let parts: Vec<_> = found.iter().map(|row| row.parts.as_slice()).collect();
        assert_eq!(parts, [&[][..], &["mola.band", "mola.north"], &[]]);
    }
}
