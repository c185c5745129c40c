//! Answers to commands and clock probes.

use protocol::message::command::{MAX_FRAME_RATE_HZ, MIN_FRAME_RATE_HZ};
use protocol::message::{ClockProbe, ClockReply, Command, CommandReply};
use protocol::time::Timestamp;

use super::{Agent, Output, Token};

impl Agent {
    pub(super) fn answer_probe(&self, now: Timestamp, token: Token, probe: ClockProbe) -> Output {
        let reply = ClockReply { probe_sent: probe.sent, received: now, replied: now, epoch: self.epoch };
        Output::ClockReply(token, reply)
    }

    pub(super) fn obey(&mut self, command: &Command) -> CommandReply {
        match command {
            Command::Status => {
                return CommandReply::Status {
                    epoch: self.epoch,
                    frames: self.duties.health.frames,
                    background_ready: self.pipeline.is_background_ready(),
                    paused: self.paused,
                    tracks: self.pipeline.tracks_now() as u32,
                    peers: self.pipeline.peers_now() as u32,
                };
            }
            Command::RestartBackground => self.pipeline.restart_background(),
            Command::ResetTracks => self.pipeline.reset_tracks(),
            Command::SetFrameRate(rate) if (MIN_FRAME_RATE_HZ..=MAX_FRAME_RATE_HZ).contains(rate) => {
                self.max_frame_rate_hz = f64::from(*rate);
            }
            Command::SetFrameRate(rate) => {
                return CommandReply::Refused(format!(
                    "the frame rate is {rate}; {MIN_FRAME_RATE_HZ} to {MAX_FRAME_RATE_HZ} frames a second can be had"
                ));
            }
            Command::Pause => self.paused = true,
            Command::Resume => self.paused = false,
        }
        CommandReply::Done
    }
}
