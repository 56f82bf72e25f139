use super::*;

fn words(text: &str) -> Vec<String> {
    text.split_whitespace().map(String::from).collect()
}

#[test]
fn words_survive_the_shell() {
    let given = ["train", "/a b/c", "it's", "--effects=-masks", "$HOME", "", "x;y", "*"];
    let shown = line(&given).unwrap();
    assert_eq!(shown, r"train '/a b/c' 'it'\''s' --effects=-masks '$HOME' '' 'x;y' '*'");
    if cfg!(unix) {
        let script = format!("printf '%s|' {shown}");
        let output = std::process::Command::new("sh").args(["-c", &script]).output().unwrap();
        assert_eq!(String::from_utf8(output.stdout).unwrap(), given.join("|") + "|");
    }
    assert!(line(&["a\nb"]).unwrap_err().to_string().contains("line feed"));
}

#[test]
fn replaced_options_go_with_their_values() {
    let given = words("--steps 7 --effects -masks --max-splats=9 --max-side 200 --sh-degree 2");
    assert_eq!(without(&given, &REPLACED), words("--steps 7 --max-side 200"));
}

#[test]
fn options_that_no_merge_could_keep_are_refused() {
    let refused = |text: &str| training(Path::new("c"), &words(text)).unwrap_err().to_string();
    for (text, part) in [
        ("--steps x", "--steps"),
        ("--out a", "leave them out"),
        ("--start a.ply", "leave them out"),
        ("--strategy mcmc", "mcmc"),
        ("--background learned", "background"),
        ("another", "another"),
    ] {
        assert!(refused(text).contains(part), "{text}: {}", refused(text));
    }
    assert_eq!(training(Path::new("c"), &words("--steps 7")).unwrap().steps, Some(7));
}
