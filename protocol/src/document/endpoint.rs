//! Endpoints in a configuration: `tcp/HOST:PORT` or `tls/HOST:PORT`.

/// Where a leader listens and an agent connects when nothing else is configured: this host alone, since without security
/// nobody else should reach it.
pub const DEFAULT_ENDPOINT: &str = "tcp/127.0.0.1:7447";

/// Why a text is not an endpoint, in words that say what would be right; `None` if it is one.
/// Port 0 (the system chooses) is right only where one `listens`.
pub fn endpoint_problem(text: &str, listens: bool) -> Option<String> {
    let Some((protocol, address)) = text.split_once('/') else {
        return Some(format!("an endpoint is a protocol, a host and a port, as {DEFAULT_ENDPOINT}"));
    };
    if !matches!(protocol, "tcp" | "tls") {
        return Some(format!("the protocol is tcp or tls, as {DEFAULT_ENDPOINT}"));
    }
    let Some((host, port)) = address.rsplit_once(':') else {
        return Some(format!("the port is missing, as in {DEFAULT_ENDPOINT}"));
    };
    if host.is_empty() || (host.contains(':') && !(host.starts_with('[') && host.ends_with(']'))) {
        return Some(
            "the host is a name, an IPv4 address or an IPv6 address in brackets, as tcp/[::1]:7447".to_owned(),
        );
    }
    match port.parse::<u16>() {
        Err(_) => Some(format!("the port is a number up to 65535, as in {DEFAULT_ENDPOINT}")),
        Ok(0) if !listens => Some("one cannot connect to port 0; give the port that the leader listens on".to_owned()),
        Ok(_) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn endpoints_with_protocol_host_and_port_are_right() {
        for text in ["tcp/127.0.0.1:7447", "tls/leader.lan:7447", "tcp/[::1]:7447", DEFAULT_ENDPOINT] {
            assert_eq!(endpoint_problem(text, false), None, "{text}");
        }
        assert_eq!(endpoint_problem("tcp/127.0.0.1:0", true), None);
    }

    #[test]
    fn anything_else_is_told_what_would_be_right() {
        for (text, part) in [
            ("127.0.0.1:7447", "protocol"),
            ("udp/127.0.0.1:7447", "tcp or tls"),
            ("tcp/127.0.0.1", "port is missing"),
            ("tcp/::1:7447", "brackets"),
            ("tcp/:7447", "host"),
            ("tcp/leader:74470", "65535"),
            ("tcp/leader:0", "port 0"),
        ] {
            let problem = endpoint_problem(text, false).unwrap_or_default();
            assert!(problem.contains(part), "{text}: {problem}");
        }
    }
}
