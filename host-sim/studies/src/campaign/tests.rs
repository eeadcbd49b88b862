use super::*;

/// Squares of numbers, and a place for their sum.
struct Squares(Vec<f64>);

impl Campaign for Squares {
    const NAME: &'static str = "squares";
    type Config = Vec<f64>;
    type Record = f64;

    fn config(&self) -> &Vec<f64> {
        &self.0
    }

    fn jobs(&self) -> usize {
        self.0.len()
    }

    fn threads(&self) -> usize {
        3
    }

    fn run(&self, job: usize) -> Result<f64, JobError> {
        if self.0[job] < 0.0 {
            return Err("a negative number".into());
        }
        Ok(self.0[job] * self.0[job])
    }

    fn finish(&self, records: &[f64], _: &Path) -> Result<Vec<String>, Box<dyn Error>> {
        Ok(records.iter().map(f64::to_string).collect())
    }
}

/// A directory that goes with the test.
struct Room(PathBuf);

impl Drop for Room {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn room(name: &str) -> Room {
    Room(std::env::temp_dir().join(format!("foretorque-campaign-{name}-{}", std::process::id())))
}

fn numbers() -> Squares {
    Squares((0..11).map(|k| f64::from(k) / 3.0).collect())
}

fn shards(room: &Room, of: usize) -> Vec<(PathBuf, ShardFile)> {
    (1..=of)
        .map(|number| {
            let shard: Shard = format!("{number}/{of}").parse().expect("is one");
            run(&numbers(), shard, &room.0, &|_, _| ()).expect("runs");
            let path = room.0.join(shard.file_name());
            let file = ShardFile::read(&path).expect("reads");
            (path, file)
        })
        .collect()
}

#[test]
fn merged_shards_say_what_the_whole_study_says() {
    let room = room("merge");
    let whole = run(&numbers(), Shard::ALL, &room.0, &|_, _| ()).expect("runs");
    assert_eq!(whole.len(), 11);
    for of in [2, 3, 16] {
        let mut files = shards(&room, of);
        files.reverse();
        let merged = merge::<Squares>(&files, |config| Ok(Squares(config)), &room.0);
        assert_eq!(merged.expect("merges"), whole, "{of}");
    }
}

#[test]
fn shards_that_do_not_make_the_study_are_refused() {
    let room = room("refuse");
    let files = shards(&room, 3);
    let said = |files: &[(PathBuf, ShardFile)]| {
        let merged = merge::<Squares>(files, |config| Ok(Squares(config)), &room.0);
        merged.expect_err("refused").to_string()
    };
    assert_eq!(said(&[]), "no shard to merge");
    assert_eq!(
        said(&files[..2]),
        "3 of 11 jobs are missing, the first is 2: not all shards are there"
    );
    let twice = [&files[..], &files[1..2]].concat();
    assert!(said(&twice).ends_with("shard-2-of-3.json: job 1 is in another file, too"));
    let mut other = files.clone();
    other[1].1.config = serde_json::json!([1.0]);
    assert!(said(&other).contains("shard-2-of-3.json: its configuration is not that of"));
    let mut older = files.clone();
    older[2].1.version = "0.0.0".to_owned();
    assert!(said(&older).contains("its version is not that of"));
}

#[test]
fn the_error_of_a_job_stops_the_study() {
    let room = room("stop");
    let failed = run(&Squares(vec![1.0, -1.0]), Shard::ALL, &room.0, &|_, _| ());
    assert_eq!(failed.expect_err("fails").to_string(), "a negative number");
}

#[test]
fn shards_are_written_as_a_part_of_a_whole() {
    assert_eq!(
        "2/8".parse::<Shard>().map(|s| s.to_string()),
        Ok("2/8".to_owned())
    );
    for bad in ["", "0/3", "4/3", "1", "a/b", "1/0", "-1/2"] {
        assert!(bad.parse::<Shard>().is_err(), "{bad}");
    }
}
