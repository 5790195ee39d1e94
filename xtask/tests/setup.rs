//! Set-up on machines where something is missing, with programs of the system played by scripts: what is installed, what
//! is said, and that nothing is called ready which is not.

#![cfg(unix)]

use std::os::unix::fs::PermissionsExt;
use std::process::Command;

/// A machine: a folder of programs that is the whole search path, and the compiler's sysroot.
struct Machine {
    dir: tempfile::TempDir,
}

impl Machine {
    /// With a compiler, without its target, emulator, linker, rustup and apt.
    fn new() -> Self {
        let machine = Self { dir: tempfile::tempdir().unwrap() };
        std::fs::create_dir_all(machine.path("sysroot/lib/rustlib")).unwrap();
        std::fs::create_dir(machine.path("bin")).unwrap();
        machine.program(
            "rustc",
            "case \"$1\" in --version) echo rustc 1.95.0;; *) echo \"$HERE/sysroot\";; esac",
        );
        machine.program("id", "echo 0");
        machine
    }

    fn path(&self, name: &str) -> std::path::PathBuf {
        self.dir.path().join(name)
    }

    /// A program; `$HERE` is the machine's folder.
    fn program(&self, name: &str, script: &str) {
        let path = self.path("bin").join(name);
        let text = format!("#!/bin/sh\nHERE='{}'\n{script}\n", self.dir.path().display());
        std::fs::write(&path, text).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
    }

    fn with_target(self) -> Self {
        std::fs::create_dir_all(self.path("sysroot/lib/rustlib/thumbv7em-none-eabihf/lib")).unwrap();
        self
    }

    fn with_emulator(self) -> Self {
        self.program("qemu-system-arm", "exit 0");
        self
    }

    /// apt-get that notes what it is asked, with lists of packages (old ones) but none of them installed.
    fn with_apt(self, install: &str) -> Self {
        self.program("dpkg-query", "exit 1");
        self.program("apt-cache", "[ -e \"$HERE/lists\" ]");
        std::fs::write(self.path("lists"), "old").unwrap();
        self.program(
            "apt-get",
            &format!(
                "echo \"$@\" >> \"$HERE/asked\"\ncase \"$*\" in *update*) echo new > \"$HERE/lists\";; \
                 *install*) {install};; esac"
            ),
        );
        self
    }

    fn without_lists(self) -> Self {
        std::fs::remove_file(self.path("lists")).unwrap();
        self
    }

    /// `xtask setup`: whether it worked, and all it said.
    fn set_up(&self) -> (bool, String) {
        let output = Command::new(env!("CARGO_BIN_EXE_xtask"))
            .arg("setup")
            .env("PATH", self.path("bin"))
            .env("RUSTC", self.path("bin/rustc"))
            .output()
            .unwrap();
        let said = [output.stdout, output.stderr].concat();
        (output.status.success(), String::from_utf8_lossy(&said).into_owned())
    }

    fn asked(&self) -> String {
        std::fs::read_to_string(self.path("asked")).unwrap_or_default()
    }
}

#[test]
fn nothing_is_installed_where_everything_is_there() {
    let machine = Machine::new().with_target().with_emulator().with_apt("exit 1");
    let (good, said) = machine.set_up();
    assert!(good && said.contains("ready: cargo with the target"), "{said}");
    assert_eq!((machine.asked().as_str(), said.lines().count()), ("", 1));
}

#[test]
fn a_missing_emulator_is_installed_with_the_reason_or_named_with_the_remedy() {
    let machine = Machine::new().with_target().with_apt(": > $HERE/bin/qemu-system-arm");
    let (good, said) = machine.set_up();
    assert!(
        good && said.contains("installing qemu-system-arm with apt-get: QEMU, to run the firmware"),
        "{said}"
    );
    assert!(
        machine.asked().contains("install --no-install-recommends qemu-system-arm"),
        "{}",
        machine.asked()
    );

    // No such system, a failing one, and one that says it did and did not: each says how to fix it.
    for machine in [
        Machine::new().with_target(),
        Machine::new().with_target().with_apt("exit 100"),
        Machine::new().with_target().with_apt("true"),
    ] {
        let (good, said) = machine.set_up();
        assert!(!good && !said.contains("ready"), "{said}");
        let last = said.lines().last().unwrap_or_default();
        assert!(
            last.contains("Debian: apt-get install qemu-system-arm") && last.contains("--host-only"),
            "{said}"
        );
    }
}

#[test]
fn old_lists_of_packages_are_fetched_and_the_installation_is_tried_again() {
    let install = "read age < $HERE/lists && [ $age = new ] && : > $HERE/bin/qemu-system-arm || exit 100";
    let verbs = |machine: &Machine| -> Vec<String> {
        let asked = machine.asked();
        asked.lines().map(|l| l.split(' ').find(|w| !w.starts_with('-')).unwrap().to_owned()).collect()
    };
    let machine = Machine::new().with_target().with_apt(install);
    let (good, said) = machine.set_up();
    assert!(good && said.contains("its lists of packages may be old"), "{said}");
    assert_eq!(verbs(&machine), ["install", "update", "install"]);
    // Where the machine has no lists they are fetched first, and the first installation is the only one.
    let machine = Machine::new().with_target().with_apt(install).without_lists();
    let (good, said) = machine.set_up();
    assert!(good, "{said}");
    assert_eq!(verbs(&machine), ["update", "install"]);
}

#[test]
fn the_target_comes_from_rustup_and_else_both_ways_to_a_compiler_are_named() {
    let machine = Machine::new().with_emulator();
    machine.program("rustup", "echo \"$@\" >> $HERE/asked; /bin/mkdir -p $HERE/sysroot/lib/rustlib/$3/lib");
    let (good, said) = machine.set_up();
    assert!(good && said.contains("installing the Rust target thumbv7em-none-eabihf with rustup"), "{said}");
    assert_eq!(machine.asked(), "target add thumbv7em-none-eabihf\n");

    let machine = Machine::new().with_emulator();
    machine.program("rustup", "exit 1");
    let (good, said) = machine.set_up();
    let last = said.lines().last().unwrap_or_default();
    assert!(!good && said.contains("rustup could not add it"), "{said}");
    assert!(last.contains("rustup target add thumbv7em-none-eabihf") && last.contains("rustc-web"), "{said}");

    let machine = Machine::new().with_emulator().with_apt("true");
    let (good, said) = machine.set_up();
    assert!(!good && machine.asked().contains("rust-web-src lld"), "{said} {}", machine.asked());
}
