//! Checks on recordings of others; they need the folder `PALTEAM_DATA` and are ignored otherwise.

use std::path::{Path, PathBuf};

use super::*;

fn data(name: &str) -> PathBuf {
    Path::new(&std::env::var("PALTEAM_DATA").expect("PALTEAM_DATA names the folder of recordings")).join(name)
}

fn gray(path: &Path) -> (usize, usize, Vec<u8>) {
    let image = image::open(path).unwrap().into_luma8();
    (image.width() as usize, image.height() as usize, image.into_raw())
}

/// Precision, recall and F of the masks on frames 470 … 1700 inside the region of interest; shadow (50) is not motion,
/// 85 and 170 are not scored.
#[test]
#[ignore = "needs PALTEAM_DATA"]
fn masks_on_the_highway_are_not_worse_than_the_plain_scheme() {
    let dir = data("cdnet/highway");
    let (_, _, roi) = gray(&dir.join("ROI.bmp"));
    let raster = Raster { width: 320, height: 240, wraps: false };
    let env = |k: &str, d: f64| std::env::var(k).map_or(d, |v| v.parse().unwrap());
    let d = MotionSettings::default();
    let settings = MotionSettings {
        halo_share: env("HALO", d.halo_share),
        floor_levels: [env("FAINT", d.floor_levels[0]), env("STRONG", d.floor_levels[1])],
        ..d
    };
    let settings = MotionSettings { own_motion: false, ..settings };
    let mut stage = MotionStage::new(raster, None, settings).unwrap();
    let (mut tp, mut fp, mut fn_, mut shadow) = (0u64, 0u64, 0u64, 0u64);
    for i in 1..=1700 {
        let (_, _, picture) = gray(&dir.join(format!("input/in{i:06}.jpg")));
        let change = stage.change(&picture, Timestamp::from_secs_f64(f64::from(i) / 25.0)).unwrap();
        if let Some(alarm) = change.alarm {
            eprintln!("frame {i}: {alarm:?}");
        }
        stage.extract();
        stage.learn(&Holds::default());
        if let Ok(dump) = std::env::var("DUMP")
            && [100, 280, 600, 1000, 1500].contains(&i)
        {
            let mut all = picture.clone();
            all.extend(stage.scene().mask.iter().map(|m| m * 255));
            all.extend(stage.background());
            all.extend(stage.background.noise.iter().map(|n| (n / 8).min(255) as u8));
            image::GrayImage::from_raw(320, 960, all).unwrap().save(format!("{dump}/h{i}.png")).unwrap();
            eprintln!("frame {i} noise {}", stage.noise_sigma());
        }
        if i < 470 {
            continue;
        }
        if i % 50 == 0 {
            eprintln!("frame {i}: tp {tp} fp {fp} fn {fn_}");
        }
        let (_, _, truth) = gray(&dir.join(format!("groundtruth/gt{i:06}.png")));
        for ((&m, &t), &r) in stage.scene().mask.iter().zip(&truth).zip(&roi) {
            if r == 0 {
                continue;
            }
            match (t, m) {
                (255, 1) => tp += 1,
                (255, _) => fn_ += 1,
                (0 | 50, 1) => {
                    fp += 1;
                    shadow += u64::from(t == 50);
                }
                _ => {}
            }
        }
    }
    let (precision, recall) = (tp as f64 / (tp + fp) as f64, tp as f64 / (tp + fn_) as f64);
    let f = 2.0 * precision * recall / (precision + recall);
    eprintln!(
        "F {f:.4} precision {precision:.4} recall {recall:.4}, {:.2} of the false in shadow",
        shadow as f64 / fp as f64
    );
    assert!(f > 0.89, "F {f}");
}
