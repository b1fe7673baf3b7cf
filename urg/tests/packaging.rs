//! Output for other programs: completions, manual pages, the list of ports.

use super::program::{COMMANDS, run};

#[test]
fn completions_for_each_shell_know_every_command() {
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let script = run(&format!("completions {shell}"), 0).stdout;
        for command in COMMANDS.iter().chain(&["--cluster", "--from"]) {
            // fish writes options without their dashes.
            let command = command.trim_start_matches('-');
            assert!(script.contains(command), "{shell} does not know {command}");
        }
    }
}

#[test]
fn every_command_has_a_manual_page() {
    let program = run("man", 0).stdout;
    assert!(program.contains(".TH URG 1"), "{program}");
    assert!(program.contains("/dev/ttyACM0"), "{program}");
    for command in COMMANDS {
        assert!(program.contains(&format!("urg\\-{command}(1)")), "{command} in\n{program}");
        let page = run(&format!("man {command}"), 0).stdout;
        assert!(page.contains(&format!(".TH URG-{} 1", command.to_uppercase())), "{page}");
        assert!(page.contains(".SH OPTIONS"), "{page}");
    }
}

#[test]
fn the_list_of_ports_can_be_json() {
    let list = run("list --format json", 0).stdout;
    let ports: serde_json::Value = serde_json::from_str(&list).unwrap();
    for port in ports.as_array().unwrap() {
        assert!(port["path"].is_string() && port["likely_sensor"].is_boolean(), "{port}");
        assert!(port["stable_paths"].is_array(), "{port}");
    }
}
