//! The words that fields may have, for the description. They are those of the inner types, so that the two cannot differ.

use crate::formats::ExistingRigPolicy;
use crate::jobs::options::Words;
use crate::jobs::webhooks::{DeliveryState, MessageType};
use crate::jobs::{Boxes, Fingers, JobState, Output, Priority, Riggable, SkinMethod, Stage, Symmetry};
use crate::pipelines::stance::{Category, Pose};
use std::borrow::Cow;
use utoipa::openapi::{ObjectBuilder, RefOr, Schema, Type};
use utoipa::{PartialSchema, ToSchema};

/// A text that is one of a few words.
macro_rules! words {
    ($($name:ident as $shown:literal, $about:literal: $words:expr;)*) => {$(
        #[doc = $about]
        pub struct $name;

        impl PartialSchema for $name {
            fn schema() -> RefOr<Schema> {
                let text = ObjectBuilder::new().schema_type(Type::String).description(Some($about));
                text.enum_values(Some($words)).into()
            }
        }

        impl ToSchema for $name {
            fn name() -> Cow<'static, str> {
                Cow::Borrowed($shown)
            }
        }
    )*};
}

words! {
    StateName as "RigState", "`expired`: succeeded once, and the results are gone.": JobState::ALL.map(JobState::name);
    EventName as "WebhookEvent", "What a webhook endpoint may be told.": MessageType::ALL.map(MessageType::name);
    RigEventName as "RigWebhookEvent", "What may be told of one rig.": MessageType::OF_RIGS.map(MessageType::name);
    MessageTypeName as "WebhookType", "What a webhook tells; `webhook.test` only when it was asked for.":
        MessageType::ALL.into_iter().chain([MessageType::Test]).map(MessageType::name);
    DeliveryStateName as "WebhookDeliveryState", "`failed`: given up.": DeliveryState::ALL.map(DeliveryState::name);
    StageName as "Stage", "A step of the work.": Stage::ALL.map(Stage::name);
    SeverityName as "Severity", "`error`: the file cannot be rigged.": ["info", "warning", "error"];
    SymmetryName as "Symmetry", "`auto`: where a mirror plane is found.": Symmetry::words();
    FingersName as "Fingers", "Which fingers there are.": Fingers::words();
    SkinMethodName as "SkinMethod", "What weighs the vertices.": Option::<SkinMethod>::words();
    BoxesName as "Boxes", "What becomes of a character made of boxes.": Boxes::words();
    ExistingRigName as "ExistingRig", "What becomes of a skeleton that is there.": ExistingRigPolicy::words();
    OutputName as "Output", "A file to make.": Output::words();
    PriorityName as "Priority", "What runs first when jobs wait.": Priority::ALL.map(Priority::name);
    RiggableName as "Riggable", "Whether a rig request would be taken; `maybe`: not as it was asked, and the findings say why.":
        Riggable::ALL.map(Riggable::name);
    CategoryName as "Category", "What the legs tell: two, two pairs, more pairs; `unknown`: nothing, as under a robe.":
        Category::ALL.map(Category::name);
    PoseName as "Pose", "How a biped holds its arms: level (`t`), obliquely down (`a`), or another way.":
        Pose::ALL.map(Pose::name);
}
