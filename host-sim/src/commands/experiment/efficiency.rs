use super::super::Failure;
use super::super::progress::Bar;
use super::super::report_files::ReportFiles;
use super::super::terminal::say;
use super::Out;
use clap::Args;
use foretorque_studies::efficiency;

/// Error of the robust fit over the Cramér-Rao bound, without and with outliers
#[derive(Debug, Args)]
#[command(allow_negative_numbers = true)]
pub(super) struct Arguments {
    #[command(flatten)]
    out: Out,
    /// Noise draws of each case
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..))]
    draws: u32,
    /// Seed of plant, prior, paths and noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let out = &arguments.out.out;
    let files = ReportFiles::create(out)?;
    let bar = Bar::new();
    let draws = arguments.draws as usize;
    let (report, page) = efficiency::run(out, arguments.seed, draws, &|stage, done, all| {
        bar.show(stage, done, all);
    })?;
    drop(bar);
    let page = files.finish(&report, &page)?;
    for case in &report.cases {
        say(format_args!(
            "{:<36} irls {:.3} x Cramér–Rao, wls {:.3} x",
            case.noise, case.irls_over_cramer_rao_ratio, case.wls_over_cramer_rao_ratio
        ))?;
    }
    say(format_args!("report       {}", page.display()))?;
    Ok(())
}
