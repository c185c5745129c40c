//! What is provisioned is accepted by the check, and what is wrong is refused in words.

use protocol::security::preflight::PreflightError;
use protocol::security::{Credentials, Member, Security};

use super::*;

/// The tests' own clock.
const NOW: Timestamp = Timestamp(1_800_000_000_000_000_000);
const YEAR: Duration = Duration::from_secs(365 * 86_400);

fn team() -> TeamId {
    TeamId::new("blue").unwrap()
}

fn id(name: &str) -> MemberId {
    MemberId::new(name).unwrap()
}

fn pki() -> (tempfile::TempDir, Pki) {
    let folder = tempfile::tempdir().unwrap();
    let pki = Pki::create(&folder.path().join("pki"), team(), NOW).unwrap();
    (folder, pki)
}

fn preflight(
    folder: PathBuf,
    role: Role,
    name: &str,
    listen: &[&str],
    now: Timestamp,
) -> Result<Vec<String>, PreflightError> {
    let listen: Vec<String> = listen.iter().map(|e| (*e).to_owned()).collect();
    let security = Security::Tls(Credentials { folder });
    let report = security.preflight(Member { team: team(), role, name }, &listen, now)?;
    Ok(report.unwrap().remarks)
}

#[test]
fn every_members_folder_passes_the_check_and_survives_a_renewal() {
    let (_keep, mut pki) = pki();
    for (role, name) in [(Role::Robot, "r1"), (Role::Leader, "l1"), (Role::Operator, "ann"), (Role::Router, "z1")] {
        for what in [Issue::First, Issue::Renewed] {
            let folder = pki.issue(role, id(name), what, &[], (NOW, YEAR)).unwrap();
            assert_eq!(preflight(folder, role, name, &[], NOW).unwrap(), [""; 0]);
        }
        assert_eq!(pki.roster().of(role)[&id(name)].issued, 1);
    }
    let again = Pki::open(&pki.folder).unwrap();
    assert_eq!(again.roster(), pki.roster());
    assert!(matches!(Pki::create(&pki.folder, team(), NOW), Err(ProvisionError::AuthorityExists(_))));
}

#[test]
fn a_key_is_readable_by_its_owner_alone() {
    use std::os::unix::fs::PermissionsExt;
    let (_keep, mut pki) = pki();
    let folder = pki.issue(Role::Robot, id("r1"), Issue::First, &[], (NOW, YEAR)).unwrap();
    for secret in [folder.join("key.pem"), pki.folder.join("authority.key")] {
        assert_eq!(std::fs::metadata(secret).unwrap().permissions().mode() & 0o777, 0o600);
    }
}

#[test]
fn a_revoked_name_never_comes_back_and_a_rotated_one_is_accepted_beside_the_new() {
    let (_keep, mut pki) = pki();
    let mut issue = |what| pki.issue(Role::Robot, id("r1"), what, &[], (NOW, YEAR)).map(|_| pki.roster().clone());
    let first = issue(Issue::First).unwrap();
    assert!(first.accepts("blue.robot.r1.1"));
    assert!(matches!(issue(Issue::First), Err(ProvisionError::Exists { .. })));
    let both = issue(Issue::Rotated).unwrap();
    assert!(both.accepts("blue.robot.r1.1") && both.accepts("blue.robot.r1.2"));
    assert_eq!(pki.revoke(Role::Robot, id("r1"), true).unwrap(), [1]);
    assert!(!pki.roster().accepts("blue.robot.r1.1") && pki.roster().accepts("blue.robot.r1.2"));
    assert_eq!(pki.revoke(Role::Robot, id("r1"), false).unwrap(), [2]);
    pki.issue(Role::Robot, id("r1"), Issue::First, &[], (NOW, YEAR)).unwrap();
    assert!(pki.roster().accepts("blue.robot.r1.3") && !pki.roster().accepts("blue.robot.r1.2"));
    let nobody = pki.revoke(Role::Robot, id("r9"), false).unwrap_err().to_string();
    assert!(nobody.contains("no robot r9"), "{nobody}");
}

#[test]
fn what_is_wrong_with_a_certificate_is_said_in_words_before_connecting() {
    let (_keep, mut pki) = pki();
    let r1 = pki.issue(Role::Robot, id("r1"), Issue::First, &[], (NOW, YEAR)).unwrap();
    let r2 = pki.issue(Role::Robot, id("r2"), Issue::First, &[], (NOW, YEAR)).unwrap();
    let said = |folder: &Path, name: &str, now| {
        preflight(folder.to_owned(), Role::Robot, name, &[], now).unwrap_err().to_string()
    };
    let has = |text: String, parts: &[&str]| {
        parts.iter().for_each(|part| assert!(text.contains(part), "{part:?} is missing in: {text}"));
    };

    has(said(&r1, "r2", NOW), &["wrong name", "blue.robot.r1.1", "blue.robot.r2"]);
    has(said(&r1, "r1", NOW + 2 * YEAR), &["expired 365 days ago", "--renew"]);
    has(said(&r1, "r1", NOW - YEAR), &["not valid for another 364 days", "clock"]);
    let soon = preflight(r1.clone(), Role::Robot, "r1", &[], NOW + (YEAR - Duration::from_secs(7 * 86_400))).unwrap();
    has(soon.join(""), &["expires in 7 days", "provision robot r1 --renew"]);
    let served = preflight(r1.clone(), Role::Leader, "r1", &[], NOW).unwrap_err();
    assert!(matches!(served, PreflightError::WrongUse { .. }), "{served}");

    std::fs::copy(r2.join("key.pem"), r1.join("key.pem")).unwrap();
    has(said(&r1, "r1", NOW), &["does not fit", "key.pem"]);
    std::fs::remove_file(r1.join("key.pem")).unwrap();
    has(said(&r1, "r1", NOW), &["key.pem", "cannot be read", "provision"]);
    std::fs::write(r2.join("certificate.pem"), "nothing").unwrap();
    has(said(&r2, "r2", NOW), &["certificate.pem", "no certificate in it"]);

    let (_other_keep, mut other) = self::pki();
    let mine = pki.issue(Role::Robot, id("r3"), Issue::First, &[], (NOW, YEAR)).unwrap();
    let theirs = other.issue(Role::Robot, id("r3"), Issue::First, &[], (NOW, YEAR)).unwrap();
    std::fs::copy(theirs.join("authority.pem"), mine.join("authority.pem")).unwrap();
    has(said(&mine, "r3", NOW), &["wrong authority", "authority.pem"]);
}

#[test]
fn a_leader_that_no_robot_could_check_or_that_is_revoked_is_refused() {
    let (_keep, mut pki) = pki();
    let hosts = ["192.168.1.10".to_owned(), "lead.local".to_owned()];
    let folder = pki.issue(Role::Leader, id("l1"), Issue::First, &hosts, (NOW, YEAR)).unwrap();
    let listens = |listen: &[&str]| preflight(folder.clone(), Role::Leader, "l1", listen, NOW);
    assert!(listens(&["tls/192.168.1.10:7447", "tls/lead.local:1", "tls/127.0.0.1:1", "tls/0.0.0.0:7447"]).is_ok());
    let error = listens(&["tls/10.0.0.7:7447"]).unwrap_err().to_string();
    for part in ["10.0.0.7", "192.168.1.10", "lead.local", "--host 10.0.0.7"] {
        assert!(error.contains(part), "{part:?} is missing in: {error}");
    }
    pki.revoke(Role::Leader, id("l1"), false).unwrap();
    let error = listens(&[]).unwrap_err().to_string();
    assert!(error.contains("not accepted") && error.contains("team.toml"), "{error}");
}

#[test]
fn a_host_that_is_none_is_refused() {
    let (_keep, mut pki) = pki();
    for (role, host, part) in [
        (Role::Leader, "192.168.1.10:7447", "no port"),
        (Role::Leader, "tls/lead", "neither"),
        (Role::Robot, "r1.local", "nobody connects to a robot"),
    ] {
        let error = pki.issue(role, id("x"), Issue::First, &[host.to_owned()], (NOW, YEAR)).unwrap_err().to_string();
        assert!(error.contains(part) && error.contains(host), "{error}");
    }
}
