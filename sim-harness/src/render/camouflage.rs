//! Clothes in the colour of what is behind: how bright the empty room is where somebody walks, as all robots see it, over
//! how much light falls on that person. Chosen once from the whole walk, separately for each kind of cover.

use super::Renderer;
use super::moving::Mover;
use crate::world::person::{COVERS, Cover};
use crate::world::wardrobe::Clothes;
use crate::world::{MAX_LAMPS, World};

/// Instants of the walk that are looked at.
const INSTANTS: usize = 16;
/// Every so many pixels of the person are looked at.
const STRIDE: usize = 5;
/// Reflectance of the clothes that the light is measured with.
const TRIAL: f32 = 0.5;

/// What everybody wears: the world's clothes, and for those who should hardly be seen clothes like the background.
pub(super) fn dress(world: &World, renderers: &mut [Renderer]) -> Vec<Clothes> {
    (0..world.people_count())
        .map(|person| {
            let own = *world.clothes(person);
            if world.is_camouflaged(person) { blend(world, renderers, person, own) } else { own }
        })
        .collect()
}

fn blend(world: &World, renderers: &mut [Renderer], person: usize, own: Clothes) -> Clothes {
    let trial = Clothes { contrast: 0.0, hair: TRIAL, ..own.plain(TRIAL) };
    // Light from behind and from the person, by cover and for all together.
    let mut sums = [[0.0f64; 2]; 5];
    let strength = [1.0; MAX_LAMPS];
    for renderer in renderers {
        for i in 0..INSTANTS {
            let state = world.at(world.duration_s() * (i as f64 + 0.5) / INSTANTS as f64);
            let here = &state.people[person];
            let mover = Mover::person(person, &world.capsules(here), trial, here.heading_rad);
            let shaders = mover.shaders(&renderer.scene, &[]);
            renderer.draw(std::slice::from_ref(&mover));
            for pixel in renderer.canvas.touched.iter().step_by(STRIDE).map(|p| *p as usize) {
                let ray = renderer.still.ray[pixel];
                let part = usize::from(renderer.canvas.shown[pixel].1);
                let Some(hit) = mover.hit_part(part, &ray, f32::INFINITY) else { continue };
                let open = shaders.open(ray.at(hit.t), &renderer.scene);
                let front = mover.glow(&hit, &ray, &renderer.scene, &open).total(&strength);
                let behind = renderer.still.glow[pixel].total(&strength);
                for sum in [COVERS[part] as usize, 4] {
                    sums[sum][0] += f64::from(behind);
                    sums[sum][1] += f64::from(front);
                }
            }
            renderer.clear();
        }
    }
    let like = |[behind, front]: [f64; 2]| (front > 0.0).then_some(TRIAL * (behind / front) as f32);
    let all = like(sums[4]).unwrap_or(TRIAL);
    let of = |cover: Cover| like(sums[cover as usize]).unwrap_or(all).clamp(0.03, 0.9);
    Clothes {
        shirt: of(Cover::Shirt),
        trousers: of(Cover::Trousers),
        shoes: of(Cover::Shoes),
        skin: of(Cover::Skin),
        hair: of(Cover::Skin) * 0.9,
        ..own.plain(all)
    }
}
