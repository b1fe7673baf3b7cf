//! The guide: how the driver works, how to use it well, and how to run it. It has
//! documentation only, no code.
//!
//! 1. [`polling`]: when scans are requested, and what a slow consumer gets
//! 2. [`trust`]: why a scan is the answer to its request, and what cannot be
//!    known
//! 3. [`recovery`]: what happens when the link is lost
//! 4. [`baud_rates`]: baud rates, and the scan rate that each can carry
//! 5. [`geometry`]: steps, angles, ranges, error codes
//! 6. [`testing`]: how to test a service without a sensor
//! 7. [`operating`]: set-up on Linux, systemd, Docker, a Raspberry Pi, a serial
//!    server, Windows
//! 8. [`logging`]: what is logged, and what to attach to a report
//! 9. [`common_issues`]: messages and symptoms, their causes and remedies
//! 10. [`recipes`]: short programs for common uses of a scanner
//! 11. [`recording`]: how to record a sensor and replay it
//! 12. [`ros2`]: `urg publish`, from one sensor to many hosts
//! 13. [`design`]: how the crate is built
//! 14. [`rationale`]: why it is built so: decisions, alternatives, evidence

macro_rules! chapters {
    ($($name:ident)*) => {
        $(
            #[doc = include_str!(concat!(stringify!($name), ".md"))]
            pub mod $name {}
        )*
    };
}

chapters! {
    polling trust recovery baud_rates geometry testing operating logging common_issues recipes recording ros2
    design rationale
}
