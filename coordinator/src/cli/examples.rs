//! Examples below each command's help. The tests parse every one, and those of README and docs.

pub(super) const PLUMBLINE: &str = "Examples:
  plumbline sample --out sample
  plumbline score sample/videos --out scores
  plumbline explain sample/videos/VIDEO.mp4 --out why

Exit codes: 0 finished; 1 stopped before the end, run again to go on; 2 usage, settings or empty input;
3 finished, but some videos have no score; 130 interrupted.";

pub(super) const SCORE: &str = "Examples:
  plumbline score rollouts --out scores
  plumbline score rollouts --out scores --group-by path:1 --keep 50%
  plumbline score episodes.csv --out scores --group-by prompt --keep 1
  plumbline score 'runs/*/videos' --out scores --profile draft --jobs 4
  plumbline score s3://BUCKET/rollouts --out s3://BUCKET/scores --queue
  plumbline score incoming --out scores --reference ref.json --watch --keep 's<=0.5' --json";

pub(super) const EVALUATE: &str = "Examples:
  plumbline evaluate scores --labels labels.csv --group-by task
  plumbline evaluate scores/scores.parquet --population source --out comparison";

pub(super) const EXPLAIN: &str = "Examples:
  plumbline explain rollout.mp4 --out why
  plumbline explain frames/ --out why --profile accurate --json";

pub(super) const FLEET: &str = "Examples:
  plumbline fleet status
  plumbline fleet dead
  plumbline fleet retry RUN
  plumbline fleet cancel RUN";

pub(super) const FLOW: &str = "Examples:
  plumbline flow a.png b.png --out flow.flo
  plumbline flow a.png b.png --out flow.png --gt truth.flo --preset fast --repeat 20 --json";

pub(super) const JUDGE: &str = "Examples:
  plumbline judge list.csv --task-column task --endpoint https://api.openai.com/v1 --model MODEL --out labels.csv
  plumbline judge rollouts --task 'put the cup on the plate' --endpoint http://127.0.0.1:8000/v1 --model MODEL --out labels.csv --max-calls 100";

pub(super) const PROFILE: &str = "Examples:
  plumbline profile show draft
  plumbline profile diff draft standard";

pub(super) const REFERENCE: &str = "Examples:
  plumbline reference fit scores --out ref.json
  plumbline reference fit --faults clean --out thresholds.json";

pub(super) const REDUCE: &str = "Examples:
  plumbline reduce scores --out other --recipe paper
  plumbline reduce part-1.parquet part-2.parquet --out whole --group-by path:1 --keep 100";

pub(super) const SAMPLE: &str = "Examples:
  plumbline sample --out sample
  plumbline sample --out other --seed 7 --no-dense-truth";

pub(super) const REPORT: &str = "Examples:
  plumbline report scores";

pub(super) const TRADEOFF: &str = "Examples:
  plumbline tradeoff rollouts --out tradeoff
  plumbline tradeoff rollouts --out tradeoff --sample 60 --keep 50% --videos 5000 --cores 64 --hours 8
  plumbline tradeoff rollouts --out tradeoff --plan-for s3://bucket/next --cores 64";

pub(super) const SLAM: &str = "Examples:
  plumbline slam walk.mp4 --out camera
  plumbline slam frames/ --out camera --intrinsics 525,525,319.5,239.5 --sequence-fps 30 --gt truth.txt";

#[cfg(test)]
mod tests {
    use std::path::Path;

    use clap::{CommandFactory, Parser};

    use super::super::Cli;

    /// Words of a shell's line: single quotes, double quotes, and a comment's start.
    fn words(line: &str) -> Vec<String> {
        let (mut words, mut word, mut quote) = (Vec::new(), None::<String>, None);
        for letter in line.chars() {
            match (quote, letter) {
                (Some(open), letter) if letter == open => quote = None,
                (None, '\'' | '"') => {
                    quote = Some(letter);
                    word.get_or_insert_default();
                }
                (None, '#') if word.is_none() => break,
                (None, ' ') => words.extend(word.take()),
                (_, letter) => word.get_or_insert_default().push(letter),
            }
        }
        words.extend(word);
        words
    }

    /// What is wrong with a line that runs `plumbline` or its worker; `None` for any other line.
    fn judged(line: &str) -> Option<Result<(), String>> {
        // What may be left out is shown in brackets, what runs in the background ends so.
        let line = line.trim().trim_end_matches(" &").replace(['[', ']'], "");
        let mut words = words(&line);
        let redirected = words.iter().position(|word| word == ">");
        words.truncate(redirected.unwrap_or(words.len()));
        // What stands for a run's name is no name itself.
        for word in words.iter_mut().filter(|word| *word == "RUN") {
            "a-run".clone_into(word);
        }
        let program = words.first()?.rsplit('/').next()?;
        let parsed = match program {
            "plumbline" => Cli::try_parse_from(&words).map(drop),
            "plumbline-worker" => plumbline_worker::cli::command()
                .try_get_matches_from(&words)
                .map(drop),
            _ => return None,
        };
        use clap::error::ErrorKind::{DisplayHelp, DisplayVersion};
        match parsed {
            Err(error) if matches!(error.kind(), DisplayHelp | DisplayVersion) => Some(Ok(())),
            parsed => Some(parsed.map_err(|error| format!("{line}: {error}"))),
        }
    }

    /// How many commands a text has; fails for one that does not parse.
    fn commands(text: &str) -> usize {
        let joined = text.replace("\\\n", " ");
        let judged = joined.lines().filter_map(judged);
        judged.map(|verdict| verdict.unwrap()).count()
    }

    #[test]
    fn every_command_has_examples_and_all_of_them_parse() {
        for command in Cli::command()
            .get_subcommands()
            .filter(|c| !c.is_hide_set())
        {
            let help = command.get_after_help().map(ToString::to_string);
            let name = command.get_name();
            assert!(
                commands(&help.unwrap_or_default()) > 0,
                "{name} has no example"
            );
        }
        assert!(commands(super::PLUMBLINE) > 0);
    }

    #[test]
    fn the_commands_of_readme_and_docs_parse() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        let docs = std::fs::read_dir(root.join("docs")).unwrap();
        let docs = docs.map(|file| file.unwrap().path());
        let pages = docs.filter(|path| path.extension().is_some_and(|end| end == "md"));
        let mut count = 0;
        for page in pages.chain([root.join("README.md")]) {
            // Blocks of code alone: every second part.
            let text = std::fs::read_to_string(&page).unwrap();
            count += text
                .split("```")
                .skip(1)
                .step_by(2)
                .map(commands)
                .sum::<usize>();
        }
        assert!(count > 15, "{count} commands found");
    }
}
