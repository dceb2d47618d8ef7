//! Growth of costs with problem size, compared with the expected growth.

use serde::{Deserialize, Serialize};

use super::conclusions::exponent;
use super::plot::{Chart, Series};
use super::table::{Table, escaped, grouped, number, significant};

/// Costs as functions of one quantity.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Growth {
    /// The quantity: a plural noun such as "pixels".
    pub of: String,
    /// The measured scene, and the settings.
    pub scene: String,
    pub curves: Vec<Cost>,
}

/// One measured cost.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cost {
    pub name: String,
    /// Largest exponent expected by design.
    pub expected: f64,
    /// Pairs of quantity and milliseconds.
    pub points: Vec<[f64; 2]>,
}

/// Tolerance for exponents above the expected one, since timings are noisy.
const NEAR: f64 = 0.15;

impl Growth {
    fn sentence(&self, cost: &Cost) -> Option<String> {
        let found = exponent(cost.points.iter().copied())?;
        let verdict = if found <= cost.expected + NEAR { "" } else { "; exceeded" };
        let [first, last] = [cost.points.first()?, cost.points.last()?];
        let count = |point: &[f64; 2]| grouped(&format!("{:.0}", point[0]));
        Some(format!(
            "{}: grows with the number of {} to the power {found:.2} (expected at most {}{verdict}), from {} ms at {} \
             to {} ms at {}.",
            cost.name,
            self.of,
            cost.expected,
            significant(first[1]),
            count(first),
            significant(last[1]),
            count(last),
        ))
    }

    fn chart(&self) -> Chart {
        let series = |(style, cost): (usize, &Cost)| {
            let points: Vec<[f64; 2]> = cost.points.iter().copied().filter(|p| p.iter().all(|v| *v > 0.0)).collect();
            let tips = points.iter().map(|p| format!("{}: {} ms", significant(p[0]), significant(p[1]))).collect();
            Series { name: cost.name.clone(), style, points, tips }
        };
        Chart {
            title: format!("Time against {}", self.of),
            x_label: format!("number of {}", self.of),
            y_label: "milliseconds",
            series: self.curves.iter().enumerate().map(series).collect(),
            floor: None,
        }
    }
}

/// Returns all costs as one table.
pub(super) fn table(growths: &[Growth]) -> Table {
    let mut table =
        Table::new("scaling.csv", &["against", "scene", "cost", "count", "ms", "exponent", "expected_at_most"]);
    for growth in growths {
        for cost in &growth.curves {
            let found = exponent(cost.points.iter().copied()).map_or_else(String::new, number);
            for [count, ms] in &cost.points {
                let head = [growth.of.clone(), growth.scene.clone(), cost.name.clone()];
                table.push(head.into_iter().chain([number(*count), number(*ms), found.clone(), number(cost.expected)]));
            }
        }
    }
    table
}

/// Returns the HTML section; empty without measurements.
pub(super) fn html(growths: &[Growth]) -> String {
    if growths.is_empty() {
        return String::new();
    }
    let sentences = growths.iter().flat_map(|g| g.curves.iter().filter_map(|cost| g.sentence(cost)));
    let items: String = sentences.map(|s| format!("<li>{}</li>\n", escaped(&s))).collect();
    // Scene names can be long, so they are captions below the charts, where they wrap.
    let figure = |g: &Growth| {
        Some(format!("<figure>{}<figcaption>{}</figcaption></figure>\n", g.chart().svg()?, escaped(&g.scene)))
    };
    let charts: String = growths.iter().filter_map(figure).collect();
    let rows = table(growths).html();
    format!(
        "<h2 id=scaling>Scaling</h2>\n<ul>{items}</ul>\n<div class=charts>{charts}</div>\n\
         <details><summary>All numbers</summary>{rows}</details>\n"
    )
}
