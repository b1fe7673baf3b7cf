//! Guide to the driver: how it works, how to use it well, and how to run it. Documentation
//! only, no code.
//!
//! 1. [`polling`]: when scans are requested, and what a slow consumer gets
//! 2. [`trust`]: why a scan is the answer to its request, and what cannot be
//!    known
//! 3. [`recovery`]: what happens when the link is lost
//! 4. [`baud_rates`]: baud rates, and the scan rate that each can carry
//! 5. [`geometry`]: steps, angles, ranges, error codes; frames and zones
//! 6. [`time`]: when each ray was measured
//! 7. [`testing`]: how to test a service without a sensor
//! 8. [`operating`]: what a service needs of its machine: Linux, systemd, Docker, a serial
//!    server, Windows
//! 9. [`logging`]: what is logged, and what to attach to a report
//! 10. [`common_issues`]: messages and symptoms, their causes and remedies
//! 11. [`recipes`]: programs for common uses of a scanner
//! 12. [`design`]: how the crate is built
//! 13. [`rationale`]: why it is built so: decisions, alternatives, evidence

macro_rules! chapters {
    ($($name:ident)*) => {
        $(
            // The targets of links are here, so that a chapter read as a file has no dead
            // links. rustdoc copies no files, so pictures are inlined: of two definitions of
            // a link target the first one counts, here the picture itself and in the file
            // its path.
            #[doc = concat!(
                include_str!("pictures/definitions.md"),
                "\n",
                include_str!(concat!(stringify!($name), ".md")),
                include_str!("links.md")
            )]
            pub mod $name {}
        )*
    };
}

chapters! {
    polling trust recovery baud_rates geometry time testing operating logging common_issues recipes design
    rationale
}
