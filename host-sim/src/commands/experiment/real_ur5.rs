use super::super::Failure;
use super::super::progress::Bar;
use super::super::report_files::ReportFiles;
use super::super::terminal::say;
use super::OfLogs;
use foretorque_studies::real_ur5;

pub(super) fn run(arguments: &OfLogs) -> Result<(), Failure> {
    let files = ReportFiles::create(&arguments.out.out)?;
    let bar = Bar::new();
    let (report, page) = real_ur5::run(&arguments.logs, arguments.seed, &|done, all| {
        bar.show("path held out", done, all);
    })?;
    drop(bar);
    let page = files.finish(&report, &page)?;
    for path in &report.paths {
        say(format_args!(
            "{:<12} {:.3}",
            path.path, path.geometric_mean_vs_wls
        ))?;
    }
    say(format_args!(
        "{} over {}: {:.3}, worst path {:.3}",
        report.recommended,
        report.reference,
        report.geometric_mean_vs_wls,
        report.worst_path_vs_wls
    ))?;
    say(format_args!("report       {}", page.display()))?;
    Ok(())
}
