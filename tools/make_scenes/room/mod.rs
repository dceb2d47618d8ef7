//! A furnished room: a scene of our own as files of artists are. Textures of every kind, leaves cut out by alpha, thin
//! and double-sided sheets, a mirror, emitters, gloss, five lights.
//!
//! Metres. The floor is y = 0; the back wall, seen straight, is z = -2.4, the window is in the left one, x = -2.6.

mod crockery;
mod drapery;
mod fireplace;
mod furniture;
mod lamps;
mod lathe;
mod looks;
mod plant;
mod shapes;
mod shelf;
mod shell;
mod sofa;
mod soft;
mod textures;

use glam::{DVec3, dvec3};

use crate::glb::{Camera, Cone, Light, Object, Scene};
use crate::mesh::Mesh;
use looks::{DUSK, GARDEN, LIT_SHADE, Look, SHADE};

/// Part of a thing, all of one material.
struct Piece {
    name: &'static str,
    mesh: Mesh,
    look: Look,
}

fn piece(name: &'static str, mesh: Mesh, look: Look) -> Piece {
    Piece { name, mesh, look }
}

#[derive(Default)]
struct Room {
    objects: Vec<Object>,
}

impl Room {
    /// Stands a thing at `translation`, turned about +Y.
    fn put(&mut self, thing: &str, pieces: Vec<Piece>, translation: DVec3, yaw_deg: f64) {
        for Piece { name, mut mesh, look } in pieces {
            mesh.uvs.iter_mut().for_each(|uv| *uv /= look.metres);
            let name = format!("{thing}_{name}");
            self.objects.push(Object { name, mesh, translation, yaw_deg, material: look.material });
        }
    }
}

/// By day: five lights. `evening`: what glows is all the light there is.
pub fn scene(evening: bool) -> Scene {
    let mut room = Room::default();
    room.put("room", shell::room(), DVec3::ZERO, 0.0);
    room.put("window", shell::window(if evening { DUSK } else { GARDEN }), DVec3::ZERO, 0.0);
    room.put("door", shell::door(), dvec3(1.80, 0.0, shell::BACK), 0.0);
    room.put("fireplace", fireplace::fireplace(), dvec3(-1.0, 0.0, shell::BREAST), 0.0);
    room.put("mirror", fireplace::mirror(), dvec3(-1.0, 1.68, shell::BREAST), 0.0);
    room.put("curtains", drapery::curtains(), DVec3::ZERO, 0.0);
    room.put("rug", drapery::rug(), dvec3(-0.72, 0.0, -0.52), 90.0);
    room.put("sofa", sofa::sofa(), dvec3(-1.95, 0.0, -0.55), 90.0);
    room.put("coffee_table", furniture::coffee_table(), dvec3(-0.80, 0.009, -0.50), 90.0);
    room.put("table", furniture::dining_table(), dvec3(1.02, 0.0, -0.70), 0.0);
    room.put("chair_near", furniture::chair(), dvec3(1.00, 0.0, 0.28), 172.0);
    room.put("chair_left", furniture::chair(), dvec3(0.34, 0.0, -0.72), 86.0);
    room.put("chair_far", furniture::chair(), dvec3(1.06, 0.0, -1.52), 4.0);
    room.put("bookshelf", shelf::bookshelf(), dvec3(0.83, 0.0, shell::BACK), 0.0);
    room.put("plant", plant::plant(), dvec3(0.06, 0.0, -2.06), 0.0);
    room.put("floor_lamp", lamps::floor_lamp(if evening { LIT_SHADE } else { SHADE }), FLOOR_LAMP, 0.0);
    room.put("reading_lamp", lamps::reading_lamp(), READING_LAMP, READING_YAW_DEG);
    room.put("ceiling_spots", lamps::ceiling_spots(&CEILING_SPOTS), DVec3::ZERO, 0.0);
    room.put("picture_back", shell::picture(0, [0.38, 0.30]), dvec3(0.07, 1.72, shell::BACK), 0.0);
    room.put("picture_alcove", shell::picture(1, [0.36, 0.46]), dvec3(-2.17, 1.82, shell::BACK), 0.0);
    room.put("picture_left", shell::picture(2, [0.50, 0.50]), dvec3(shell::LEFT, 1.60, 1.35), 90.0);
    room.put("picture_right", shell::picture(3, [0.60, 0.45]), dvec3(shell::RIGHT, 1.60, 0.0), -90.0);
    if evening {
        room.put("reading", lamps::reading_bulb(), READING_LAMP, READING_YAW_DEG);
        room.put("ceiling", lamps::ceiling_glow(&CEILING_SPOTS), DVec3::ZERO, 0.0);
        room.put("laptop", furniture::laptop(), dvec3(0.95, furniture::DINING_HEIGHT, -0.62), 24.0);
    } else {
        room.put("table_ware", crockery::on_dining_table(), dvec3(1.02, furniture::DINING_HEIGHT, -0.70), 0.0);
    }
    room.put("coffee_ware", crockery::on_coffee_table(), dvec3(-0.80, furniture::COFFEE_HEIGHT + 0.009, -0.50), 0.0);
    room.put("mantel_ware", crockery::on_mantel(), dvec3(-1.0, fireplace::MANTEL_HEIGHT, shell::BREAST + 0.11), 0.0);
    Scene {
        name: if evening { "room-evening" } else { "room" },
        image_size: [720, 480],
        camera: Camera { position: dvec3(1.95, 1.50, 2.55), target: dvec3(-0.55, 0.92, -1.55), yfov_deg: 46.0 },
        lights: if evening { Vec::new() } else { lights() },
        objects: room.objects,
        textures: textures::all(),
    }
}

const FLOOR_LAMP: DVec3 = dvec3(-2.15, 0.0, -2.05);
const READING_LAMP: DVec3 = dvec3(-2.15, 0.0, 0.72);
const READING_YAW_DEG: f64 = 65.0;
/// Where their light leaves them.
const CEILING_SPOTS: [DVec3; 2] = [dvec3(1.2, 2.56, 0.75), dvec3(-0.6, 2.56, 0.45)];

/// Two spots in the ceiling, the floor lamp, daylight, a reading lamp at the sofa.
fn lights() -> Vec<Light> {
    let warm = [1.0, 0.80, 0.56];
    let spot = |position, target, color, intensity, inner_deg, outer_deg| Light {
        position,
        color,
        intensity,
        cone: Some(Cone { target, inner_deg, outer_deg }),
    };
    let [over_table, over_sofa] = CEILING_SPOTS;
    vec![
        spot(over_table, dvec3(0.85, 0.3, -0.8), [1.0, 0.90, 0.76], 30.0, 26.0, 58.0),
        spot(over_sofa, dvec3(-2.1, 0.9, -0.5), [1.0, 0.90, 0.76], 24.0, 24.0, 56.0),
        Light { position: FLOOR_LAMP + dvec3(0.0, 1.50, 0.0), color: warm, intensity: 3.2, cone: None },
        spot(dvec3(-4.3, 3.1, -0.95), dvec3(-0.6, 0.0, -0.40), [1.0, 0.96, 0.90], 200.0, 9.0, 17.0),
        spot(READING_LAMP + lamps::reading_light(READING_YAW_DEG), dvec3(-1.75, 0.45, -0.35), warm, 10.0, 18.0, 40.0),
    ]
}
