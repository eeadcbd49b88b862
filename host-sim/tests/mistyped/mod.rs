//! Command lines that cannot be obeyed, where `good.csv` and its like are in the directory.

/// Each with the words that the one line of the program must have.
pub(crate) fn mistyped() -> Vec<(String, &'static [&'static str])> {
    let torque = "torque --robot ur5 --out tau.csv --in";
    let run = "run --robot ur5 --out out --trajectory";
    vec![
        ("frobnicate".to_owned(), &["'frobnicate'"]),
        (
            "experment demo --out out".to_owned(),
            &["'experment'", "'experiment'"],
        ),
        (
            "experiment dmeo --out out".to_owned(),
            &["'dmeo'", "'demo'"],
        ),
        ("experiment demo".to_owned(), &["--out <DIR>"]),
        (
            "experiment demo --out out --sede 3".to_owned(),
            &["'--sede'", "'--seed'"],
        ),
        (
            "experiment demo --out out --seed x".to_owned(),
            &["'x'", "--seed"],
        ),
        (
            "experiment demo --out out --board quemu".to_owned(),
            &["'quemu'", "native"],
        ),
        (
            "experiment demo --out out --learning-s nan".to_owned(),
            &["learning"],
        ),
        (
            "experiment demo --out file/out --board native".to_owned(),
            &["file/out"],
        ),
        (format!("{torque} missing.csv"), &["missing.csv"]),
        (
            format!("{torque} columns.csv"),
            &["columns.csv:1", "q3_rad"],
        ),
        (
            format!("{torque} twice.csv"),
            &["twice.csv:1", "q2_rad", "twice"],
        ),
        (
            format!("{torque} ragged.csv"),
            &["ragged.csv:3", "18 fields", "19"],
        ),
        (
            format!("{torque} nan.csv"),
            &["nan.csv:3", "qd2_rad_s", "NaN"],
        ),
        (
            format!("{torque} word.csv"),
            &["word.csv:4", "qdd6_rad_s2", "fast"],
        ),
        (format!("{torque} time.csv"), &["time.csv:4", "t_s"]),
        (format!("{torque} empty.csv"), &["empty.csv", "no rows"]),
        (
            format!("{torque} seven.csv"),
            &["seven.csv:1", "q7_rad", "6 joints"],
        ),
        (
            "torque --robot ur5 --in good.csv --out good.csv".to_owned(),
            &["--out good.csv", "read"],
        ),
        (
            format!("{torque} good.csv --key-file none"),
            &["--bank <FILE>"],
        ),
        (format!("{torque} good.csv --bank bank.bin"), &["bank.bin"]),
        (format!("{torque} good.csv --bank none.bin"), &["none.bin"]),
        (
            format!("{torque} good.csv --board serial:/dev/ttyNOWHERE7"),
            &["/dev/ttyNOWHERE7"],
        ),
        (
            "torque --robot ur5 --in good.csv --out file/tau.csv".to_owned(),
            &["file"],
        ),
        (
            "torque --robot ur7 --in good.csv --out tau.csv".to_owned(),
            &["'ur7'"],
        ),
        (format!("{run} missing.csv"), &["missing.csv"]),
        (format!("{run} nan.csv"), &["nan.csv:3", "qd2_rad_s"]),
        (format!("{run} series.json"), &["series.json"]),
        (
            format!("{run} far.csv"),
            &["far.csv", "joint 2", "-6.400 rad", "0.001 s"],
        ),
        (
            format!("{run} fast.csv"),
            &["fast.csv", "joint 3", "3.300 rad/s", "3.142"],
        ),
        (
            format!("{run} hard.csv"),
            &["hard.csv", "joint 6", "10.500 rad/s²", "0.002 s"],
        ),
        (
            format!("{run} validation --duration-s=-1"),
            &["--duration-s"],
        ),
        (
            "run --robot ur5 --out file/out --trajectory validation".to_owned(),
            &["file/out"],
        ),
        (
            "simulate --robot ur5 --out log.csv --trajectory fast.csv".to_owned(),
            &["fast.csv", "joint 3"],
        ),
        (
            "simulate --robot ur5 --out file/log.csv --trajectory validation".to_owned(),
            &["file"],
        ),
        (
            "simulate --robot ur5 --out good.csv --trajectory good.csv".to_owned(),
            &["--out good.csv", "read"],
        ),
        (
            "simulate --robot ur5 --out log.csv --trajectory good.csv --pd-bandwidth-hz 1e6".to_owned(),
            &["--pd-bandwidth-hz", "100"],
        ),
        (
            "simulate --robot ur5 --out log.csv --trajectory good.csv --seed -1".to_owned(),
            &["'-1'", "--seed"],
        ),
        (
            "excite --robot ur5 --out file".to_owned(),
            &["file"],
        ),
        (
            "excite --robot ur5 --out out --period-s 1e9".to_owned(),
            &["--period-s", "1000"],
        ),
        (
            "excite --robot ur5 --out out --table-m 3".to_owned(),
            &["to table", "asked for"],
        ),
        (
            "identify --robot ur5 --log torques.csv --motion-hz 460 --out out".to_owned(),
            &["torques.csv", "--motion-hz is 460", "450", "rows a second"],
        ),
        (
            "identify --robot ur5 --log torques.csv --torque-hz 1e4 --out out".to_owned(),
            &["torques.csv", "--torque-hz is 10000"],
        ),
        (
            "identify --robot ur5 --log good.csv --period-s 3 --out out".to_owned(),
            &["--period-s", "--filter fourier"],
        ),
        (
            "identify --robot ur5 --log missing.csv --out out".to_owned(),
            &["missing.csv"],
        ),
        (
            "identify --robot ur5 --log torques.csv --units q=grad --out out".to_owned(),
            &["'grad' is no unit of q: rad, deg, rev"],
        ),
        (
            "identify --robot ur5 --log torques.csv --columns-from nowhere --out out".to_owned(),
            &["nowhere", "ros, rtde, franka, lerobot"],
        ),
        ("compare torques.csv nothing".to_owned(), &["torques.csv: no report"]),
        (
            "replay --robot ur5 --log good.csv --out out".to_owned(),
            &["good.csv:1", "tau1_nm"],
        ),
        (
            format!("{run} validation --payload 3@2..1"),
            &["--payload", "end after that"],
        ),
        (
            format!("{run} validation --push 7:10@1..2"),
            &["--push", "no joint 7"],
        ),
        (
            format!("{run} validation --lost 1.5"),
            &["--lost", "between 0 and 1"],
        ),
        (
            "experiment learning --only frobnicate --out out".to_owned(),
            &["'frobnicate'", "--list"],
        ),
        (
            "experiment learning --snapshot none.txt --out out".to_owned(),
            &["none.txt"],
        ),
        (
            "experiment replay-real --logs nowhere --out out".to_owned(),
            &["nowhere", "--logs DIR"],
        ),
        (
            "experiment real-ur5 --out file".to_owned(),
            &["file"],
        ),
        (
            "experiment efficiency --out file".to_owned(),
            &["file"],
        ),
        (
            "experiment soak --ticks 0 --out out".to_owned(),
            &["'0'", "--ticks"],
        ),
        ("experiment demo --quick --out out".to_owned(), &["'--quick'"]),
        ("experiment".to_owned(), &["--list"]),
        ("bank file".to_owned(), &["file"]),
        (
            "run --robot ur5 --board qemu-usart --trajectory validation --out out --log file/board.log"
                .to_owned(),
            &["file"],
        ),
    ]
}
