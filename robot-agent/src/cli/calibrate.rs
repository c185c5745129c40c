//! `robot-agent calibrate`.

mod centre;
mod convert;
mod floor;
mod locus;
mod model;
mod mounting;
mod radial;
mod verify;

use std::io::{self, Write};
use std::path::Path;

use clap::{Args, Subcommand};
use robot_agent::calibration::report;
use serde_json::Value;

use super::{Failure, Format};

/// Finds out what a camera's parameters are, how well they are known, and whether the model is right.
#[derive(Debug, Args)]
pub(super) struct Arguments {
    #[command(subcommand)]
    job: Job,
}

#[derive(Debug, Subcommand)]
enum Job {
    Model(model::Arguments),
    Centre(centre::Arguments),
    Radial(radial::Arguments),
    Verify(verify::Arguments),
    Locus(locus::Arguments),
    Floor(floor::Arguments),
    Mounting(mounting::Arguments),
    Import(convert::Import),
    Export(convert::Export),
}

/// Runs the command.
pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    match &arguments.job {
        Job::Model(arguments) => model::execute(arguments),
        Job::Centre(arguments) => centre::execute(arguments),
        Job::Radial(arguments) => radial::execute(arguments),
        Job::Verify(arguments) => verify::execute(arguments),
        Job::Locus(arguments) => locus::execute(arguments),
        Job::Floor(arguments) => floor::execute(arguments),
        Job::Mounting(arguments) => mounting::execute(arguments),
        Job::Import(arguments) => convert::import(arguments),
        Job::Export(arguments) => convert::export(arguments),
    }
}

/// Words for people or numbers for programs.
fn print(format: Format, words: &[String], numbers: &Value) -> Result<(), Failure> {
    let mut output = io::stdout().lock();
    match format {
        Format::Json => writeln!(output, "{numbers}")?,
        Format::Text => words.iter().try_for_each(|line| writeln!(output, "{line}"))?,
    }
    Ok(())
}

/// The same, and a report where one is wanted: a page with the words, and the numbers as JSON.
fn tell(format: Format, report: Option<&Path>, title: &str, words: &[String], numbers: &Value) -> Result<(), Failure> {
    if let Some(folder) = report {
        report::write_findings(title, words, numbers, folder).map_err(Failure::job)?;
    }
    print(format, words, numbers)
}

/// The text of a camera file that is written to another place: what it names is named from there.
fn moved(mut file: toml::Table, from: &Path, to: &Path) -> Result<String, Failure> {
    let wrong = |e: &dyn std::fmt::Display| Failure::usage(format!("{}: {e}", from.display()));
    let folder = |path: &Path| path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new(".")).to_owned();
    let [old, new] = [from, to].map(folder);
    let is_elsewhere = match (old.canonicalize(), new.canonicalize()) {
        (Ok(old), Ok(new)) => old != new,
        _ => old != new,
    };
    let mask = file.get_mut("mask").and_then(toml::Value::as_table_mut).and_then(|mask| mask.get_mut("file"));
    if let Some(name) = mask.filter(|_| is_elsewhere)
        && let Some(path) = name.as_str().map(|name| old.join(name))
    {
        let path = path.canonicalize().map_err(|e| wrong(&format!("`mask.file` {}: {e}", path.display())))?;
        *name = toml::Value::String(path.display().to_string());
    }
    toml::to_string(&file).map_err(|e| wrong(&e))
}

/// A camera file as a table.
fn read_table(path: &Path) -> Result<toml::Table, Failure> {
    let wrong = |e: &dyn std::fmt::Display| Failure::usage(format!("{}: {e}", path.display()));
    let text = std::fs::read_to_string(path).map_err(|e| wrong(&e))?;
    text.parse().map_err(|e: toml::de::Error| wrong(&e))
}

fn save(path: &Path, text: &str) -> Result<(), Failure> {
    std::fs::write(path, text).map_err(|e| Failure::job(format!("{}: cannot be written: {e}", path.display())))
}

/// Two numbers with a comma, as on the command line.
fn pair(text: &str) -> Result<[f64; 2], String> {
    let numbers: Vec<f64> = text.split(',').filter_map(|word| word.trim().parse().ok()).collect();
    match numbers.as_slice() {
        &[a, b] if a.is_finite() && b.is_finite() => Ok([a, b]),
        _ => Err("must be two numbers with a comma between them, as 383.5,287.5".into()),
    }
}

/// A JSON file of a command's input.
fn read_json<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T, Failure> {
    let text = std::fs::read_to_string(path)
        .map_err(|e| Failure::usage(format!("{}: cannot be read: {e}", path.display())))?;
    serde_json::from_str(&text).map_err(|e| Failure::usage(format!("{}: {e}", path.display())))
}
