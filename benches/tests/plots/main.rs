//! The plots of `docs/pareto/` are those of the tables beside them, which `splat pareto` wrote. `SPLAT_PLOTS=accept cargo test --release -p
//! splat-benches --test plots` draws them anew.

mod chart;

use std::fs;
use std::path::Path;

use chart::{Chart, Dot, Quartiles, Role, svg};

/// The fields of a line, some of which are in quotation marks.
fn fields(line: &str) -> Vec<String> {
    let (mut fields, mut is_quoted) = (vec![String::new()], false);
    for letter in line.chars() {
        match letter {
            '"' => is_quoted = !is_quoted,
            ',' if !is_quoted => fields.push(String::new()),
            letter => fields.last_mut().unwrap().push(letter),
        }
    }
    fields
}

/// The settings of a table that have an error.
fn dots(table: &str) -> Vec<Dot> {
    let mut lines = table.lines().map(fields);
    let titles = lines.next().unwrap();
    let dot = |line: Vec<String>| {
        let field = |title: &str| line[titles.iter().position(|of| of == title).unwrap()].as_str();
        let number = |title: &str| field(title).parse::<f64>();
        let [lower, median, upper] =
            ["forward_ms_lower", "forward_ms", "forward_ms_upper"].map(|title| number(title).unwrap());
        let role = match field("role") {
            "preset" => Role::Preset,
            "combination" => Role::Combination,
            _ => Role::Dial,
        };
        let (name, member) = (field("name").to_owned(), field("on_frontier") == "1");
        Some(Dot { name, role, x: Quartiles { lower, median, upper }, y: number("error_db").ok()?, member })
    };
    lines.filter_map(dot).collect()
}

#[test]
fn plots_are_those_of_the_tables_beside_them() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/pareto");
    let accepts = std::env::var("SPLAT_PLOTS").is_ok_and(|wish| wish == "accept");
    for name in ["demo", "fox_colmap", "bonsai"] {
        let table = fs::read_to_string(folder.join(name).with_extension("csv")).unwrap();
        let plot = svg(&Chart { title: name.into(), dots: dots(&table) }).unwrap();
        let file = folder.join(name).with_extension("svg");
        if accepts {
            fs::write(&file, plot).unwrap();
        } else {
            assert!(fs::read_to_string(&file).unwrap() == plot, "{name}.svg is of another table: accept the new one");
        }
    }
}
