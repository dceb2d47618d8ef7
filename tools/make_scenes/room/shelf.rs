//! A bookshelf full of books, its back at z = 0, round x = 0.

use glam::{DAffine3, DVec2, dvec2, dvec3};

use super::crockery::{jar, small_vase};
use super::looks::{BLUE_GLAZE, BOOKS, OAK, PAPER, TERRACOTTA};
use super::shapes::{board, sheet};
use super::textures::{BOOK_COLUMNS, BOOK_ROWS};
use super::{Piece, piece};
use crate::mesh::{Mesh, cuboid, joined};
use crate::noise::Chance;

const WIDTH: f64 = 0.86;
const DEPTH: f64 = 0.28;
const HEIGHT: f64 = 2.02;
const BOARD: f64 = 0.022;
const SHELVES: u32 = 6;

/// Undersides of the boards that books stand on, from the floor up.
fn shelf_y(index: u32) -> f64 {
    0.08 + f64::from(index) * (HEIGHT - 0.08 - BOARD) / f64::from(SHELVES)
}

pub fn bookshelf() -> Vec<Piece> {
    let mut chance = Chance::new(11);
    let mut books = Books::default();
    for shelf in 0..SHELVES {
        fill(&mut books, shelf_y(shelf) + BOARD, shelf, &mut chance);
    }
    let on_shelf = |shelf: u32, mesh: Mesh, x: f64| mesh.moved(dvec3(x, shelf_y(shelf) + BOARD, 0.16));
    vec![
        piece("wood", frame(), OAK),
        piece("books", books.bindings, BOOKS),
        piece("pages", books.pages, PAPER),
        piece("vase", on_shelf(4, small_vase(), 0.33), BLUE_GLAZE),
        piece("jar", on_shelf(2, jar(), -0.30), TERRACOTTA),
    ]
}

fn frame() -> Mesh {
    let half = WIDTH / 2.0;
    let sides = [-half, half - BOARD].map(|x| board(dvec3(x, 0.0, 0.0), dvec3(x + BOARD, HEIGHT, DEPTH)));
    let boards = (0..=SHELVES).map(|i| {
        let y = shelf_y(i);
        board(dvec3(-half + BOARD, y, 0.006), dvec3(half - BOARD, y + BOARD, DEPTH - 0.004))
    });
    let back = board(dvec3(-half + BOARD, 0.08, 0.0), dvec3(half - BOARD, HEIGHT - 0.001, 0.008));
    let plinth = board(dvec3(-half + BOARD, 0.0, DEPTH - 0.03), dvec3(half - BOARD, 0.08, DEPTH - 0.015));
    joined(sides.into_iter().chain(boards).chain([back, plinth]))
}

#[derive(Default)]
struct Books {
    bindings: Mesh,
    pages: Mesh,
}

/// Books from left to right, with gaps for what else stands there; at the end one leans or a few lie.
fn fill(books: &mut Books, y: f64, shelf: u32, chance: &mut Chance) {
    let (mut x, end) = (-WIDTH / 2.0 + BOARD + 0.002, WIDTH / 2.0 - BOARD - 0.002);
    let (from, to) = match shelf {
        2 => (x + 0.26, end),
        4 => (x, end - 0.22),
        1 | 5 => (x, end - 0.17),
        _ => (x, end - 0.02),
    };
    x = from;
    let mut tallest = 0.20;
    let mut cell = chance.below(BOOK_COLUMNS * BOOK_ROWS);
    loop {
        // Series of equal books, now and then.
        let of_series = chance.within(0.0, 1.0) < 0.35;
        if !of_series {
            cell = chance.below(BOOK_COLUMNS * BOOK_ROWS);
            tallest = chance.within(0.17, 0.265);
        }
        let size = dvec3(chance.within(0.016, 0.046), tallest, (tallest * 0.72).clamp(0.12, 0.19));
        if x + size.x > to {
            break;
        }
        let front = DEPTH - 0.018 - chance.within(0.0, 0.02) - (0.19 - size.z) * 0.3;
        let place = DAffine3::from_translation(dvec3(x + size.x / 2.0, y, front));
        books.push(size, cell, place);
        x += size.x + chance.within(0.0005, 0.002);
    }
    match shelf {
        // Leans on its neighbour: its lower left edge stays on the board.
        1 => {
            let size = dvec3(0.030, 0.22, 0.16);
            let lean = 12f64.to_radians();
            let foot = dvec3(x + size.y * lean.sin() + 0.002, y, DEPTH - 0.03);
            let place = DAffine3::from_translation(foot)
                * DAffine3::from_rotation_z(lean)
                * DAffine3::from_translation(dvec3(size.x / 2.0, 0.0, 0.0));
            books.push(size, 9, place);
        }
        // A pile, spines to the front.
        5 => {
            let mut top = y;
            for i in 0..4 {
                let size = dvec3(chance.within(0.022, 0.038), 0.155 - 0.008 * f64::from(i), 0.13);
                let lying = DAffine3::from_rotation_z(std::f64::consts::FRAC_PI_2);
                let at = dvec3(x + 0.008 + size.y, top + size.x / 2.0, DEPTH - 0.05 - chance.within(0.0, 0.02));
                books.push(size, chance.below(BOOK_COLUMNS * BOOK_ROWS), DAffine3::from_translation(at) * lying);
                top += size.x + 0.0005;
            }
        }
        _ => {}
    }
}

impl Books {
    /// A book that stands on the origin, its spine to +Z; `cell` is its print.
    fn push(&mut self, size: glam::DVec3, cell: u32, place: DAffine3) {
        const COVER: f64 = 0.0022;
        let half = size.x / 2.0;
        let cells = dvec2(f64::from(BOOK_COLUMNS), f64::from(BOOK_ROWS));
        let corner = dvec2(f64::from(cell % BOOK_COLUMNS), f64::from(cell / BOOK_COLUMNS));
        let print = |t: DVec2| (corner + t) / cells;

        let mut spine = sheet([6, 1], DVec2::ONE, |t| {
            let out = 1.0 - (2.0 * t.x - 1.0).powi(2);
            dvec3((t.x - 0.5) * size.x, t.y * size.y, 0.0045 * out)
        });
        // A hair inside the cell, so that its neighbours don't bleed in.
        spine.uvs.iter_mut().for_each(|uv| *uv = print(*uv * 0.94 + 0.03));
        let mut covers =
            joined([-half, half - COVER].map(|x| cuboid(dvec3(x, 0.0, -size.z), dvec3(x + COVER, size.y, 0.0))));
        covers.uvs.iter_mut().for_each(|uv| *uv = print(dvec2(0.08, 0.5)));
        let pages = cuboid(dvec3(-half + COVER, 0.003, -size.z + 0.003), dvec3(half - COVER, size.y - 0.003, 0.0));
        self.bindings.append(joined([spine, covers]).placed(place));
        self.pages.append(pages.placed(place));
    }
}

/// A pile of three on a table, standing on the origin.
pub fn lying_books() -> Vec<Piece> {
    let mut books = Books::default();
    let mut y = 0.0;
    for (size, cell, yaw) in [
        (dvec3(0.036, 0.270, 0.200), 8, 20.0),
        (dvec3(0.024, 0.235, 0.170), 13, 27.0),
        (dvec3(0.020, 0.190, 0.125), 21, 12.0f64),
    ] {
        let place = DAffine3::from_translation(dvec3(0.0, y + size.x / 2.0, 0.0))
            * DAffine3::from_rotation_y(yaw.to_radians())
            * DAffine3::from_rotation_z(std::f64::consts::FRAC_PI_2)
            * DAffine3::from_translation(dvec3(0.0, -size.y / 2.0, size.z / 2.0));
        books.push(size, cell, place);
        y += size.x + 0.0005;
    }
    vec![piece("bindings", books.bindings, BOOKS), piece("pages", books.pages, PAPER)]
}
