use super::super::Failure;
use super::super::progress::Bar;
use super::super::report_files::ReportFiles;
use super::super::terminal::say;
use super::OfLogs;
use foretorque_studies::replay_real;

pub(super) fn run(arguments: &OfLogs) -> Result<(), Failure> {
    let files = ReportFiles::create(&arguments.out.out)?;
    let bar = Bar::new();
    let (report, page) = replay_real::run(&arguments.logs, arguments.seed, &|stage, done, all| {
        bar.show(stage, done, all);
    })?;
    drop(bar);
    files.finish(&report, &page)?;
    for (value, what) in [
        (report.aged_10_s_vs_rich_wls_ratio, "parameters 10 s old"),
        (
            report.aged_10_s_after_other_paths_vs_rich_wls_ratio,
            "the same, other paths before",
        ),
        (report.newest_vs_rich_wls_ratio, "parameters as they are"),
        (report.frozen_vs_rich_wls_ratio, "data sheet, frozen"),
        (
            report.plain_wls_vs_rich_wls_ratio,
            "plain batch least squares",
        ),
    ] {
        say(format_args!("{what:<28} {value:.3} × {}", report.reference))?;
    }
    say(format_args!(
        "decisions of the guard       {:?}",
        report.decisions_count
    ))?;
    Ok(())
}
