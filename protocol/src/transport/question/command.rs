//! Commands by people: words in the key's parameters, answers as JSON.

use serde_json::{Value, json};

use crate::codec::Message;
use crate::message::{Command, CommandReply};

/// The command of `do=…`; the status where there is none.
pub(super) fn command_from_words(parameter: &dyn Fn(&str) -> Option<String>) -> Result<Command, String> {
    let command = match parameter("do").as_deref() {
        None | Some("status") => Command::Status,
        Some("restart_background") => Command::RestartBackground,
        Some("reset_tracks") => Command::ResetTracks,
        Some("set_frame_rate") => {
            let rate = parameter("rate_hz").ok_or("set_frame_rate needs rate_hz, as in do=set_frame_rate;rate_hz=5")?;
            let number = rate.parse().map_err(|_| format!("rate_hz is {:?}, not a number", short(&rate)))?;
            Command::SetFrameRate(number)
        }
        Some("pause") => Command::Pause,
        Some("resume") => Command::Resume,
        Some(other) => {
            return Err(format!(
                "there is no command {:?}; there are status, restart_background, reset_tracks, set_frame_rate, pause, resume",
                short(other)
            ));
        }
    };
    command.validate().map_err(|invalid| invalid.to_string())?;
    Ok(command)
}

/// The reply for people.
pub(super) fn reply_as_json(reply: &CommandReply) -> Value {
    match reply {
        CommandReply::Done => json!({ "reply": "done" }),
        CommandReply::Refused(why) => json!({ "reply": "refused", "why": why }),
        CommandReply::Status { epoch, frames, background_ready, paused, tracks, peers } => json!({
            "reply": "status",
            "epoch": epoch,
            "frames": frames,
            "background_ready": background_ready,
            "paused": paused,
            "tracks": tracks,
            "peers": peers,
        }),
    }
}

fn short(text: &str) -> String {
    text.chars().take(32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_command_has_its_words() {
        let said = |text: &'static str| {
            let find = move |name: &str| {
                text.split(';').find_map(|pair| pair.split_once('=').filter(|p| p.0 == name).map(|p| p.1.to_owned()))
            };
            command_from_words(&find)
        };
        assert_eq!(said(""), Ok(Command::Status));
        assert_eq!(said("do=status"), Ok(Command::Status));
        assert_eq!(said("do=restart_background"), Ok(Command::RestartBackground));
        assert_eq!(said("do=reset_tracks"), Ok(Command::ResetTracks));
        assert_eq!(said("do=set_frame_rate;rate_hz=5"), Ok(Command::SetFrameRate(5.0)));
        assert_eq!(said("do=pause"), Ok(Command::Pause));
        assert_eq!(said("do=resume"), Ok(Command::Resume));
        for wrong in ["do=dance", "do=set_frame_rate", "do=set_frame_rate;rate_hz=x", "do=set_frame_rate;rate_hz=-1"] {
            assert!(said(wrong).is_err(), "{wrong}");
        }
    }
}
