//! The section against the endpoints.

use super::*;

fn checked(section: &str, role: Role, listen: &[&str], connect: &[&str]) -> Result<Security, String> {
    let document = Document::from_text(Path::new("/etc/pal/x.toml"), section.to_owned());
    #[derive(Deserialize)]
    struct File {
        security: Option<RawSecurity>,
    }
    let raw: File = document.parse().map_err(|e| e.to_string())?;
    let own = |list: &[&str]| list.iter().map(|e| (*e).to_owned()).collect::<Vec<_>>();
    let who = Member { team: TeamId::new("blue").unwrap(), role, name: "r1" };
    Security::checked(&document, raw.security.as_ref(), who, Some(&own(listen)), Some(&own(connect)))
        .map_err(|e| e.to_string())
}

#[test]
fn without_the_section_a_leader_listens_on_this_host_alone() {
    for own in ["tcp/127.0.0.1:7447", "tcp/[::1]:0", "tcp/localhost:7447"] {
        assert_eq!(checked("", Role::Leader, &[own], &[]), Ok(Security::Loopback), "{own}");
    }
    for open in ["tcp/0.0.0.0:7447", "tcp/[::]:7447", "tcp/192.168.1.10:7447", "tcp/leader.lan:7447"] {
        let error = checked("", Role::Leader, &["tcp/127.0.0.1:1", open], &[]).unwrap_err();
        for part in ["network.listen", open, "127.0.0.1", "mode = \"tls\"", "mode = \"none\"", "provision"] {
            assert!(error.contains(part), "{part:?} is missing in: {error}");
        }
    }
    assert_eq!(
        checked("[security]\nmode = 'none'\n", Role::Leader, &["tcp/0.0.0.0:7447"], &[]),
        Ok(Security::Open),
        "said explicitly"
    );
}

#[test]
fn under_tls_every_endpoint_is_tls_and_without_it_none() {
    let tls = "[security]\nmode = 'tls'\nfolder = 'pki/r1'\n";
    let security = checked(tls, Role::Robot, &[], &["tls/10.0.0.1:7447"]).unwrap();
    let Security::Tls(credentials) = &security else { panic!("{security:?}") };
    assert_eq!(credentials.key(), Path::new("/etc/pal/pki/r1/key.pem"));
    assert_eq!(security.default_endpoint(), "tls/127.0.0.1:7447");
    let error = checked(tls, Role::Robot, &[], &["tls/10.0.0.1:7447", "tcp/10.0.0.2:7447"]).unwrap_err();
    assert!(error.contains("tcp/10.0.0.2:7447") && error.contains("begins with tls/"), "{error}");
    let error = checked("", Role::Robot, &[], &["tls/10.0.0.1:7447"]).unwrap_err();
    assert!(error.contains("needs [security]"), "{error}");
}

#[test]
fn passwords_are_for_a_team_with_a_single_router() {
    let robot = "[security]\nmode = 'password'\npassword_file = 'mine'\n";
    let leader = "[security]\nmode = 'password'\npassword_file = 'mine'\npasswords_file = 'all'\n";
    assert!(
        matches!(checked(robot, Role::Robot, &[], &["tcp/10.0.0.1:1"]), Ok(Security::Password(p)) if p.user == "robot.r1")
    );
    assert!(checked(leader, Role::Leader, &["tcp/10.0.0.1:7447"], &[]).is_ok());
    for (section, role, connect) in
        [(robot, Role::Robot, &["tcp/10.0.0.1:1", "tcp/10.0.0.2:1"][..]), (leader, Role::Leader, &["tcp/10.0.0.2:1"])]
    {
        let error = checked(section, role, &[], connect).unwrap_err();
        assert!(error.contains("single router") && error.contains("tls"), "{error}");
    }
}

#[test]
fn a_wrong_mode_or_a_key_of_another_mode_is_named_with_its_line() {
    for (section, role, parts) in [
        ("[security]\nmode = 'ssl'\n", Role::Robot, ["x.toml:2", "\"tls\""]),
        ("[security]\nmode = 'none'\nfolder = 'pki'\n", Role::Robot, ["x.toml:3", "no such key"]),
        ("[security]\nmode = 'tls'\npassword_file = 'x'\n", Role::Robot, ["x.toml:3", "no such key"]),
        ("[security]\nmode = 'password'\n", Role::Robot, ["security.password_file", "own password"]),
        ("[security]\nmode = 'password'\npassword_file = 'x'\n", Role::Leader, ["passwords_file", "everybody's"]),
        ("[security]\nmode = 'tls'\nfile = 'x'\n", Role::Robot, ["x.toml:3", "`folder`"]),
    ] {
        let error = checked(section, role, &[], &[]).unwrap_err();
        for part in parts {
            assert!(error.contains(part), "{part:?} is missing in: {error}");
        }
    }
}
