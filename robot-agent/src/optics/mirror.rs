//! Which way round a camera and its mirror stand.

use serde::{Deserialize, Serialize};

/// Where the camera is, seen from its mirror. `MATHS.md` §1.1 has it above, looking down; on robots it is often below,
/// looking up, and the mirror hangs over it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum CameraSide {
    /// The optics' axis, from the mirror to its camera, is z.
    #[default]
    Above,
    /// It is −z.
    Below,
}

impl CameraSide {
    pub(crate) fn is_upside_down(self) -> bool {
        self == Self::Below
    }
}
