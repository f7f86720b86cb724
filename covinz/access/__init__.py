"""Who may connect to a server and what they may do: certificates, credentials, roster, rules."""
