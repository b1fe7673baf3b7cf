//! The emulator's encoders and parsers are written from the protocol texts: a misreading of a text
//! in the driver or in the emulator then fails a test of their exchange.

#[test]
fn protocols_use_only_baud_rates_of_the_driver() {
    for source in [
        include_str!("../src/format.rs"),
        include_str!("../src/scip1/command.rs"),
        include_str!("../src/scip1/dialect.rs"),
        include_str!("../src/scip2/command.rs"),
        include_str!("../src/scip2/encode.rs"),
        include_str!("../src/scip2/session.rs"),
        include_str!("../src/scip2/texts.rs"),
    ] {
        let mut uses = source.split("tokio_scip").skip(1);
        assert!(uses.all(|used| used.starts_with("::BaudRate;")));
    }
}
