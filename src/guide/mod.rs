//! The guide: how the driver works, how to use it well, and how to run it. Docs
//! only; there is no code in here.
//!
//! 1. [`polling`]: how scans are asked for, and what a slow consumer gets
//! 2. [`trust`]: why a scan is the answer to its request, and what cannot be
//!    known
//! 3. [`recovery`]: what happens when the link is lost
//! 4. [`baud_rates`]: baud rates, and what rate each can carry
//! 5. [`geometry`]: steps, angles, ranges
//! 6. [`testing`]: your service without a sensor
//! 7. [`operating`]: permissions, names, systemd, Docker, a Raspberry Pi, Windows
//! 8. [`logging`]: what is logged, and what to attach to a report
//! 9. [`common_issues`]: what people stumble over
//! 10. [`recipes`]: short programs for what people do with a scanner
//! 11. [`recording`]: keeping what a sensor said, and replaying it
//! 12. [`design`]: how the crate is built

macro_rules! chapters {
    ($($name:ident)*) => {
        $(
            #[doc = include_str!(concat!(stringify!($name), ".md"))]
            pub mod $name {}
        )*
    };
}

chapters! {
    polling trust recovery baud_rates geometry testing operating logging common_issues recipes recording design
}
