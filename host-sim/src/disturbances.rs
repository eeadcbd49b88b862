//! Options for disturbances of the simulated arm and faults of its reports.

use super::{Failure, bail, finite, fitting, not_negative, positive, share};
use clap::{Args, FromArgMatches as _};
use foretorque_workbench::dynamics::Joints;
use foretorque_workbench::plant::{Events, Payload, PlantConfig, PlantEffects, Push, ReportFaults};
use std::ops::Range;
use std::path::PathBuf;

/// Options for events and effects on the simulated arm.
#[derive(Debug, PartialEq, Args)]
#[command(next_help_heading = "Disturbances")]
pub(super) struct DisturbanceArguments {
    /// A payload of so many kg is in the hand from T1 to T2, s; may be given several times
    #[arg(long, value_name = "KG@T1..T2", value_parser = held)]
    payload: Vec<During<f64>>,
    /// Centre of mass of the payloads in the frame of the last link, m
    #[arg(long, value_name = "X,Y,Z", value_parser = triple)]
    #[arg(default_value = "0,0,0.1323", allow_hyphen_values = true)]
    payload_com: [f64; 3],
    /// A torque from outside, N·m, on joint J (from 1) from T1 to T2, s; may be given several times
    #[arg(long, value_name = "J:NM@T1..T2", value_parser = pushed)]
    push: Vec<During<(usize, f64)>>,
    /// Growth of viscous friction, share in ten minutes
    #[arg(long, default_value_t = 0.3, allow_hyphen_values = true, value_parser = growth)]
    viscous_drift: f64,
    /// Coulomb friction under load, share of the torque against gravity and velocity products
    #[arg(long, default_value_t = 0.0, value_parser = not_negative)]
    load_friction: f64,
    /// Torque the drives make over the torque asked of them: torque constants that are wrong
    #[arg(long, default_value_t = 1.0, value_parser = positive)]
    drive_gain: f64,
    /// Effects of real drives: elastic gears, backlash, sticking, drifting sensors, delays (see docs/identification.md)
    #[arg(long, value_name = "FILE.toml")]
    pub(super) effects: Option<PathBuf>,
}

/// Options for faults of the reports of a simulated arm.
#[derive(Debug, Args)]
#[command(next_help_heading = "Disturbances")]
pub(super) struct FaultArguments {
    /// Factor on every reported torque: a wrong current sensor; negative = wrong sign
    #[arg(long, default_value_t = 1.0, allow_hyphen_values = true, value_parser = not_zero)]
    sensor_gain: f64,
    /// Share of reported torques that are off by 20 % of the limit
    #[arg(long, default_value_t = 0.0, value_parser = share)]
    outliers: f64,
    /// Share of reported positions with a flipped encoder bit
    #[arg(long, default_value_t = 0.0, value_parser = share)]
    glitches: f64,
    /// Share of reports that carry a number that is none
    #[arg(long, default_value_t = 0.0, value_parser = share)]
    not_a_number: f64,
    /// Share of reports that are lost: in no log, and the board has none in that tick
    #[arg(long, default_value_t = 0.0, value_parser = part)]
    lost: f64,
    /// Share of reports that are late: the one before comes in their place
    #[arg(long, default_value_t = 0.0, value_parser = share)]
    late: f64,
}

/// Something from one time to another, s.
#[derive(Clone, Debug, PartialEq)]
struct During<T> {
    what: T,
    time_s: Range<f64>,
}

/// A share that leaves something.
fn part(text: &str) -> Result<f64, String> {
    fitting(
        text,
        |value| (0.0..1.0).contains(&value),
        "must be at least 0 and below 1",
    )
}

/// A growth that leaves something of what grows.
fn growth(text: &str) -> Result<f64, String> {
    fitting(text, |value| value > -1.0, "must be more than -1")
}

fn not_zero(text: &str) -> Result<f64, String> {
    fitting(text, |value| value != 0.0, "must be a number other than 0")
}

/// A mass, kg, from one time to another.
fn held(text: &str) -> Result<During<f64>, String> {
    during(text, |mass| {
        positive(mass).map_err(|error| format!("a mass {error}"))
    })
}

/// A joint, from 1, and the torque on it, N·m, from one time to another.
fn pushed(text: &str) -> Result<During<(usize, f64)>, String> {
    during(text, |push| {
        let (joint, torque) = push.split_once(':').ok_or("not of the form J:NM@T1..T2")?;
        let number = joint.parse().ok().filter(|joint| *joint > 0);
        let number = number.ok_or_else(|| format!("'{joint}' is no joint, they count from 1"))?;
        Ok((number, finite(torque)?))
    })
}

pub(super) fn triple(text: &str) -> Result<[f64; 3], String> {
    let values: Vec<f64> = text.split(',').map(finite).collect::<Result<_, _>>()?;
    let three = values.try_into();
    three.map_err(|_| "not three numbers".to_owned())
}

fn during<T>(
    text: &str,
    what: impl FnOnce(&str) -> Result<T, String>,
) -> Result<During<T>, String> {
    let parts = text.split_once('@');
    let (happens, time) = parts.ok_or("no @ between what and when it happens")?;
    let (from, to) = time.split_once("..").ok_or("no .. between begin and end")?;
    let time_s = finite(from)?..finite(to)?;
    if time_s.start < 0.0 || time_s.is_empty() {
        return Err("it must begin at 0 s or later, and end after that".to_owned());
    }
    let what = what(happens)?;
    Ok(During { what, time_s })
}

impl DisturbanceArguments {
    /// The plant, its noise apart.
    ///
    /// Errors: a file of effects that is none.
    pub(super) fn plant_config(&self) -> Result<PlantConfig, Failure> {
        Ok(PlantConfig {
            viscous_drift: self.viscous_drift / 600.0,
            load_friction: self.load_friction,
            drive_gain: self.drive_gain,
            effects: match &self.effects {
                Some(file) => PlantEffects::load(file)?,
                None => PlantEffects::default(),
            },
            ..PlantConfig::default()
        })
    }

    /// Events that the options name, in a motion of `duration_s`.
    ///
    /// Errors: a joint it has not; an event after its end.
    pub(super) fn events<const N: usize>(&self, duration_s: f64) -> Result<Events<N>, Failure> {
        let mut events = Events::default();
        let payloads = self.payload.iter().map(|it| ("--payload", it.time_s.start));
        let pushes = self.push.iter().map(|it| ("--push", it.time_s.start));
        if let Some((option, from_s)) = payloads.chain(pushes).find(|it| it.1 >= duration_s) {
            bail!("{option}: it begins at {from_s} s, the motion ends at {duration_s:.3} s");
        }
        let mut held: Vec<_> = self.payload.iter().map(|it| it.time_s.clone()).collect();
        held.sort_by(|a, b| a.start.total_cmp(&b.start));
        if let Some(pair) = held.windows(2).find(|pair| pair[1].start < pair[0].end) {
            let (next_s, end_s) = (pair[1].start, pair[0].end);
            bail!(
                "--payload: one begins at {next_s} s, the one before ends at {end_s} s: the arm has one in its hand at a time"
            );
        }
        for During { what, time_s } in &self.payload {
            let payload = Payload::cube(*what, self.payload_com, time_s.start, time_s.end);
            events.payloads.push(payload);
        }
        for During { what, time_s } in &self.push {
            let mut torque = Joints::<N>::zeros();
            let (joint, torque_nm) = *what;
            let Some(place) = torque.get_mut(joint - 1) else {
                bail!("--push: there is no joint {joint}, the last one is {N}");
            };
            *place = torque_nm;
            events.pushes.push(Push {
                torque,
                from_s: time_s.start,
                to_s: time_s.end,
            });
        }
        Ok(events)
    }

    /// True where an option is not its default.
    ///
    /// Errors: a default that is refused.
    pub(super) fn any(&self) -> Result<bool, Failure> {
        let command = Self::augment_args(clap::Command::new(""));
        Ok(*self != Self::from_arg_matches(&command.try_get_matches_from([""])?)?)
    }
}

impl FaultArguments {
    pub(super) fn faults(&self) -> ReportFaults {
        ReportFaults {
            torque_gain: self.sensor_gain,
            outliers: self.outliers,
            glitches: self.glitches,
            not_a_number: self.not_a_number,
            lost: self.lost,
            late: self.late,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_happens_is_read_as_it_is_written() {
        let payload = held("2.5@1..4.5").expect("a payload");
        assert_eq!((payload.what, payload.time_s), (2.5, 1.0..4.5));
        let push = pushed("2:-30@0.5..0.6").expect("a push");
        assert_eq!((push.what, push.time_s), ((2, -30.0), 0.5..0.6));
        for bad in ["2.5", "2.5@1", "x@1..2", "2@2..1", "2@-1..2", "2@1..1"] {
            assert!(held(bad).is_err(), "{bad}");
        }
        for bad in ["3@1..2", "0:3@1..2", "x:3@1..2", "1:@1..2"] {
            assert!(pushed(bad).is_err(), "{bad}");
        }
    }
}
