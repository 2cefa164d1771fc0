//! What the hand does: pointer and keys, to orbits and wishes.

use areoid_formats::units::Radians;
use glam::DVec2;
use winit::event::{ElementState, MouseButton, MouseScrollDelta, WindowEvent};
use winit::keyboard::{Key, ModifiersState, NamedKey};

use super::settings::{Lighting, Settings};
use crate::orbit::Orbit;
use crate::render::Debug;

/// Pixels that an arrow key drags.
const KEY_STEP_PX: f64 = 60.0;
/// Radians to a pixel of a turning drag.
const TURN_PER_PX: f64 = 0.005;
/// Nearer by this much for a notch of the wheel.
const NOTCH: f64 = 0.8;
/// Pixels of a touchpad that make a notch.
const PX_PER_NOTCH: f64 = 40.0;

/// Where the pointer is and what is held down.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Hand {
    pub(super) position: DVec2,
    left: bool,
    right: bool,
    modifiers: ModifiersState,
}

/// What a key asks for beyond the view and the settings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Order {
    End,
    AddBookmark,
    GoTo(usize),
    Record,
    Screenshot,
    TogglePanel,
}

impl Hand {
    /// What an event of the pointer does to a view of `pixel_angle` radians to a pixel.
    pub(super) fn point(&mut self, event: &WindowEvent, orbit: &mut Orbit, pixel_angle: f64) {
        match event {
            WindowEvent::CursorMoved { position, .. } => {
                let to = DVec2::new(position.x, position.y);
                let by = to - self.position;
                self.position = to;
                let turns = self.right || (self.left && self.modifiers.shift_key());
                if turns {
                    orbit.turn(Radians(by.x * TURN_PER_PX), Radians(-by.y * TURN_PER_PX));
                } else if self.left {
                    orbit.drag(by.x, by.y, pixel_angle);
                }
            }
            WindowEvent::MouseInput { state, button, .. } => {
                let down = *state == ElementState::Pressed;
                match button {
                    MouseButton::Left => self.left = down,
                    MouseButton::Right => self.right = down,
                    _ => {}
                }
            }
            WindowEvent::MouseWheel { delta, .. } => {
                let notches = match delta {
                    MouseScrollDelta::LineDelta(_, lines) => f64::from(*lines),
                    MouseScrollDelta::PixelDelta(pixels) => pixels.y / PX_PER_NOTCH,
                };
                orbit.zoom(NOTCH.powf(notches));
            }
            WindowEvent::ModifiersChanged(modifiers) => self.modifiers = modifiers.state(),
            _ => {}
        }
    }

    /// Lets go: what is held down now is somebody else's.
    pub(super) fn release(&mut self) {
        (self.left, self.right) = (false, false);
    }
}

/// What a key does to a view and to the settings, and what it asks for.
pub(super) fn press(
    key: &Key,
    orbit: &mut Orbit,
    settings: &mut Settings,
    pixel_angle: f64,
) -> Option<Order> {
    let step = KEY_STEP_PX;
    match key.as_ref() {
        Key::Named(NamedKey::Escape) => return Some(Order::End),
        Key::Named(NamedKey::ArrowLeft) => orbit.drag(step, 0.0, pixel_angle),
        Key::Named(NamedKey::ArrowRight) => orbit.drag(-step, 0.0, pixel_angle),
        Key::Named(NamedKey::ArrowUp) => orbit.drag(0.0, step, pixel_angle),
        Key::Named(NamedKey::ArrowDown) => orbit.drag(0.0, -step, pixel_angle),
        Key::Character("+" | "=") => orbit.zoom(NOTCH),
        Key::Character("-") => orbit.zoom(1.0 / NOTCH),
        Key::Character("n" | "N") => orbit.face_north(),
        Key::Character("e" | "E") => {
            let next = 2.0 * settings.exaggeration.max(0.5);
            settings.exaggeration = if next > 8.0 { 1.0 } else { next };
        }
        Key::Character("l" | "L") => {
            settings.lighting = match settings.lighting {
                Lighting::Headlamp => Lighting::Sun,
                Lighting::Sun => Lighting::Relief,
                Lighting::Relief => Lighting::Headlamp,
            };
        }
        Key::Character("a" | "A") => settings.has_air = !settings.has_air,
        Key::Character("c" | "C") => settings.has_ramp = !settings.has_ramp,
        Key::Character("d" | "D") => {
            settings.debug = match settings.debug {
                Debug::Off => Debug::Level,
                Debug::Level => Debug::Dataset,
                Debug::Dataset => Debug::Borders,
                Debug::Borders => Debug::Residency,
                Debug::Residency => Debug::Error,
                Debug::Error => Debug::Off,
            };
        }
        Key::Character("v" | "V") => {
            settings.arrangement = settings.arrangement.next();
        }
        Key::Character("b" | "B") => return Some(Order::AddBookmark),
        Key::Character("r" | "R") => return Some(Order::Record),
        Key::Character("p" | "P") => return Some(Order::Screenshot),
        Key::Character("h" | "H") => return Some(Order::TogglePanel),
        Key::Character(text) => {
            let digit = text.parse::<usize>().ok().filter(|digit| (1..=9).contains(digit));
            return digit.map(|digit| Order::GoTo(digit - 1));
        }
        _ => {}
    }
    None
}
